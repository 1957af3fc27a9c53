# SPDX-License-Identifier: BSD-3-Clause
"""Lamps, skylights and patches of sunlight, drawn at random."""

from dataclasses import dataclass, field
from typing import List, Tuple

import numpy as np

from ceiling_dso_ros.simulation.ceilings.drawn.hangings import CLOSE_M, LOWEST_M
from ceiling_dso_ros.simulation.ceilings.drawn.roofs import Roof
from ceiling_dso_ros.simulation.rendering import structures
from ceiling_dso_ros.simulation.rendering.geometry import Surface
from ceiling_dso_ros.simulation.rendering.lighting import Source
from ceiling_dso_ros.simulation.rendering.materials import Material

DARK = Material(0.5)  # a lamp that is off
SOURCE_ABOVE_M = 0.05
WALL_M = 0.5  # lamps keep so far away from the walls


@dataclass
class Lights:
    """The lights of a hall.

    Attributes:
        surfaces: lamps, glass, patches.
        sources: the lamps that are on.
        kind: of the lamps.
        lamps: how many there are.
        share_off: of them that are off.
        skylights, sun_patches: how many there are.
    """

    surfaces: List[Surface] = field(default_factory=list)
    sources: List[Source] = field(default_factory=list)
    kind: str = ""
    lamps: int = 0
    share_off: float = 0.0
    skylights: int = 0
    sun_patches: int = 0


def draw_lights(rng: np.random.Generator, roof: Roof, is_periodic: bool) -> Lights:
    """Lamps in a grid or in lines, a group of them off, skylights with patches of sunlight."""
    lights = Lights(kind=str(rng.choice(["tubes", "bays", "panels"] if roof.kind == "flat" else ["tubes", "bays"])))
    places = _lamp_places(rng, roof, is_periodic)
    is_off = np.zeros(len(places), dtype=bool)
    if not is_periodic and rng.random() < 0.4:  # one side of the hall, and single ones
        is_off = (places[:, 0] > rng.uniform(-0.5, 0.5) * roof.size_m[0]) | (rng.random(len(places)) < 0.1)
    gleam = Material(float(np.exp(rng.uniform(np.log(0.9), np.log(6.0)))), luminous=True)
    power, hanging_m = rng.uniform(0.03, 0.3), rng.uniform(0.0, max(0.0, min(roof.lowest_m - LOWEST_M - 0.4, 1.5)))
    for (x, y), off in zip(places, is_off):
        lamp = DARK if off else gleam
        if lights.kind == "panels":
            z = roof.lowest_m
            lights.surfaces += structures.panel_lamp((x - 0.6, y - 0.3, z), 1.2, 0.6, lamp)
        elif lights.kind == "tubes":
            z = roof.height(y) - 0.15 - hanging_m
            lights.surfaces += structures.tube_lamp((x, y, z), 0.0, lamp=lamp)
        else:
            z = roof.height(y) - 0.45 - hanging_m
            lights.surfaces += structures.bay_lamp((x, y, z), 0.22, lamp)
        if not off:
            position = np.array([x, y, z - (0.4 if lights.kind == "panels" else -SOURCE_ABOVE_M)])
            lights.sources.append(Source(position, power, False))
    lights.lamps, lights.share_off = len(places), float(is_off.mean()) if len(places) else 0.0
    _add_skylights(rng, roof, is_periodic, lights)
    return lights


def _lamp_places(rng: np.random.Generator, roof: Roof, is_periodic: bool) -> np.ndarray:
    """(n, 2) x and y."""
    length, width = (side - 2 * WALL_M for side in roof.size_m)
    pitch_x, pitch_y = rng.uniform(2.2, 6.0), rng.uniform(2.4, 6.0)
    if rng.random() < 0.35:  # lines of lamps with hardly a gap
        pitch_x = 1.6
    x = np.arange(-length / 2 + pitch_x / 2, length / 2, pitch_x)
    y = np.arange(-width / 2 + pitch_y / 2, width / 2, pitch_y)
    places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return places if is_periodic else places + rng.uniform(-0.1, 0.1, places.shape)


def _add_skylights(rng: np.random.Generator, roof: Roof, is_periodic: bool, lights: Lights) -> None:
    """Panes in the planes of the roof, and what the sun draws through them on its underside."""
    if roof.lowest_m < 3.0 or rng.random() < 0.5:
        return
    pane_x, pane_y, pitch = rng.uniform(0.8, 2.5), rng.uniform(0.8, 2.0), rng.uniform(3.5, 8.0)
    glass = Material(float(rng.uniform(0.7, 1.6)), luminous=True)
    sun = Material(float(rng.uniform(0.7, 1.3)), luminous=True)
    for y0, y1 in roof.planes():
        if y1 - y0 < pane_y + 0.6:
            continue
        y = (y0 + y1 - pane_y) / 2
        for x in np.arange(-roof.size_m[0] / 2 + pitch / 2, roof.size_m[0] / 2 - pane_x, pitch):
            lights.surfaces.append(roof.patch((x, x + pane_x), (y, y + pane_y), glass, CLOSE_M / 2))
            lights.skylights += 1
            if not is_periodic and rng.random() < 0.3 and y1 - y - pane_y > 0.5:
                reach: Tuple[float, float] = (y + pane_y + 0.1, min(y + pane_y + 0.1 + 0.4 * pane_y, y1 - 0.05))
                lights.surfaces.append(roof.patch((x + 0.3, x + 0.3 + 0.6 * pane_x), reach, sun, CLOSE_M / 2))
                lights.sun_patches += 1
