# SPDX-License-Identifier: BSD-3-Clause
"""A warehouse: 9 m to a flat roof on long beams, lamps in rows, racks that reach far up."""

from typing import List

import numpy as np

from ceiling_dso_ros.simulation.obstacles import Obstacles, person, vehicle
from ceiling_dso_ros.simulation.rendering import materials, structures
from ceiling_dso_ros.simulation.rendering.geometry import Surface, beam, quad
from ceiling_dso_ros.simulation.rendering.lighting import Source
from ceiling_dso_ros.simulation.rendering.scene import Hall

LENGTH, WIDTH, HEIGHT = 40.0, 26.0, 9.0


def warehouse(rng: np.random.Generator) -> Hall:
    """Concrete girders and long steel beams under a deck, skylights, sprinklers, a duct, bay lamps, high racks."""
    a, b = LENGTH / 2, WIDTH / 2
    surfaces: List[Surface] = [
        structures.downward([(a, -b), (a, b), (-a, b), (-a, -b)], HEIGHT, materials.DECK),
        *structures.room_walls(LENGTH, WIDTH, HEIGHT, materials.CLADDING),
    ]
    for x in np.arange(-16.0, 17.0, 8.0):
        surfaces += beam((x, -b, 8.1), (x, b, 8.1), 0.4, 0.9, materials.CONCRETE)
    for y in np.arange(-11.2, 12.0, 3.2):
        surfaces += structures.i_beam((-a, y, 8.8), (a, y, 8.8), 0.36, 0.18)
    lamps = [(x + rng.uniform(-0.2, 0.2), y, 7.4) for y in (-8.0, -1.6, 4.8, 10.4) for x in np.arange(-17.0, 18.0, 4.9)]
    for x, y, z in lamps:
        surfaces += structures.bay_lamp((x, y, z), 0.3)
        surfaces += structures.hangers([(x, y, z + 0.35)], [8.9], 0.01)
    surfaces += _skylights(rng) + _services() + _racks(rng)
    sources = [Source(np.array([x, y, z + 0.05]), 0.5, False) for x, y, z in lamps]
    pallets = [(12.0, -6.0, 0.6, 0.4), (-11.0, 5.0, 0.4, 0.6)]
    movers = (vehicle((-12.0, 7.9), (12.0, 7.9), speed_m_s=1.2), person((-9.5, -6.0), (-9.5, 6.0)))
    return Hall(
        surfaces, sources, (LENGTH, WIDTH), Obstacles(structures.room_plan(LENGTH, WIDTH, [*RACKS, *pallets]), movers)
    )


def _skylights(rng: np.random.Generator) -> List[Surface]:
    surfaces: List[Surface] = []
    for x in np.arange(-13.0, 15.0, 8.0) + rng.uniform(-0.6, 0.6):
        for y in (-5.6, 1.0, 7.2):
            surfaces.append(quad((x, y + 1.0, HEIGHT - 0.01), (2.4, 0, 0), (0, -1.0, 0), materials.SKYLIGHT))
            for u in np.linspace(x, x + 2.4, 4):
                surfaces += beam((u, y, HEIGHT - 0.03), (u, y + 1.0, HEIGHT - 0.03), 0.07, 0.05, materials.STEEL)
    return surfaces


def _services() -> List[Surface]:
    surfaces = structures.round_duct([(-19.5, -3.2, 7.2), (17.0, -3.2, 7.2)], 0.45)
    for x in np.arange(-17.0, 17.0, 4.0):
        surfaces += structures.diffuser((x, -3.2, 6.85), 0.5)
    for y in (-9.6, -5.0, 3.0, 8.9):
        surfaces += structures.pipe([(-19.5, y, 7.55), (19.5, y, 7.55)], 0.035)
        for x in np.arange(-18.0, 19.0, 3.1):
            surfaces += structures.sprinkler((x, y, 7.55))
    surfaces += structures.pipe([(12.0, -12.8, 7.65), (12.0, 12.8, 7.65)], 0.08)
    surfaces += structures.cable_tray((-19.5, 6.3, 7.5), (19.5, 6.3, 7.5), 0.4)
    surfaces += structures.cable_tray((-6.0, -12.8, 7.35), (-6.0, 6.3, 7.35), 0.3)
    for k, x in enumerate((-12.0, -2.0, 8.0)):
        surfaces += structures.sign((x, 0.6, 6.6), np.pi * (k % 2), f"AISLE {k + 1}", 2.0)
    return surfaces


RACKS = ((0.0, 9.6, 12.0, 0.6), (0.0, -9.9, 12.0, 0.6))  # center x, y, half length, half depth


def _racks(rng: np.random.Generator) -> List[Surface]:
    surfaces: List[Surface] = []
    for x, y, half_length, half_depth in RACKS:
        levels = (0.2, 1.8, 3.4, 5.0)
        surfaces += structures.rack((x - half_length, y), (x + half_length, y), 2 * half_depth, levels, rng)
    return surfaces
