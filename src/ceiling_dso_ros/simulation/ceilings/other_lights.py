# SPDX-License-Identifier: BSD-3-Clause
"""A hall at another time: other lamps are off."""

from dataclasses import replace
from typing import Sequence

import numpy as np

from ceiling_dso_ros.simulation.rendering.geometry import Sheet, Surface
from ceiling_dso_ros.simulation.rendering.lighting import Source
from ceiling_dso_ros.simulation.rendering.materials import Material
from ceiling_dso_ros.simulation.rendering.scene import Hall

SHARE_OFF = 1.0 / 3.0
UNLIT = Material(0.5)
REACH_M = 0.9  # of a lamp around its source, to the sides
REACH_UP_M = 0.6


def with_lamps_off(hall: Hall, rng: np.random.Generator) -> Hall:
    """The hall with a third of the lamps off that are on otherwise."""
    is_off = np.zeros(len(hall.lamps), bool)
    is_off[rng.permutation(len(hall.lamps))[: round(SHARE_OFF * len(hall.lamps))]] = True
    off = [lamp for lamp, dark in zip(hall.lamps, is_off) if dark]
    on = [lamp for lamp, dark in zip(hall.lamps, is_off) if not dark]
    return replace(hall, surfaces=[_seen(surface, on, off) for surface in hall.surfaces], lamps=on)


def _seen(surface: Surface, on: Sequence[Source], off: Sequence[Source]) -> Surface:
    """A surface as it looks now: it is dark if it belongs to a lamp that is off."""
    if not surface.sheet.material.luminous or _distance(surface, off) >= min(1.0, _distance(surface, on)):
        return surface
    return replace(surface, sheet=Sheet(UNLIT, surface.sheet.size_m))


def _distance(surface: Surface, lamps: Sequence[Source]) -> float:
    """How far a surface is from the nearest source, in parts of the reach of a lamp; inf without any."""
    if not lamps:
        return float("inf")
    apart = np.abs(np.array([lamp.position for lamp in lamps]) - surface.vertices.mean(axis=0))
    return float((apart / (REACH_M, REACH_M, REACH_UP_M)).max(axis=1).min())
