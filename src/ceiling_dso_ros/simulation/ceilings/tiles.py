# SPDX-License-Identifier: BSD-3-Clause
"""An office: a flat suspended ceiling at 3 m, in which the same tile and lamp repeat."""

from typing import List

import numpy as np

from ceiling_dso_ros.simulation.obstacles import Obstacles, person
from ceiling_dso_ros.simulation.rendering import materials, structures
from ceiling_dso_ros.simulation.rendering.geometry import Surface, box, quad
from ceiling_dso_ros.simulation.rendering.lighting import Source
from ceiling_dso_ros.simulation.rendering.scene import Hall

LENGTH, WIDTH, HEIGHT = 21.0, 15.0, 3.0
TILE = 0.6
COLUMNS = ((-4.8, 6.2), (4.8, 6.2), (-4.8, -6.6), (4.8, -6.6))
CUPBOARDS = (0.0, 7.2, 10.0, 0.25)  # center x, y, half length, half depth


def tiles(rng: np.random.Generator) -> Hall:
    """Mineral tiles in a T-bar grid, flush lamps on a regular raster, outlets, detectors, signs; columns, cupboards."""
    corner = np.array([-LENGTH / 2, -WIDTH / 2])
    lamps = [corner + TILE * np.array([i, j]) for i in range(2, 35, 4) for j in range(2, 25, 4)]
    surfaces: List[Surface] = [
        structures.downward(_rectangle(LENGTH, WIDTH), HEIGHT, materials.MINERAL_TILES),
        *structures.room_walls(LENGTH, WIDTH, HEIGHT, materials.PAINTED_WALL),
    ]
    for x, y in lamps:
        surfaces += structures.panel_lamp((x, y, HEIGHT), 2 * TILE, TILE)
    surfaces += _fittings(rng) + _furniture(rng)
    sources = [Source(np.array([x + TILE, y + TILE / 2, HEIGHT - 0.4]), 0.02, False) for x, y in lamps]
    floor_plan = structures.room_plan(LENGTH, WIDTH, [(x, y, 0.2, 0.2) for x, y in COLUMNS] + [CUPBOARDS])
    people = (person((-8.0, -5.9), (8.0, -5.9)), person((8.6, 5.0), (8.6, -4.0), speed_m_s=0.9))
    return Hall(surfaces, sources, (LENGTH, WIDTH), Obstacles(floor_plan, people))


def _rectangle(length: float, width: float) -> List[tuple]:
    a, b = length / 2, width / 2
    return [(-a, -b), (a, -b), (a, b), (-a, b)]


def _fittings(rng: np.random.Generator) -> List[Surface]:
    """Fittings that interrupt the grid: air outlets, smoke detectors, sprinklers, loudspeakers, exit signs."""
    surfaces: List[Surface] = []
    for i, j in ((8, 5), (16, 17), (24, 9), (28, 21), (4, 13), (12, 21), (20, 1)):
        x, y = -LENGTH / 2 + TILE * i + 0.03, -WIDTH / 2 + TILE * j + 0.03
        surfaces.append(quad((x, y + 0.54, HEIGHT - 0.005), (0.54, 0, 0), (0, -0.54, 0), materials.OUTLET))
    for x in np.arange(-9.3, 9.5, 4.8):
        for y in np.arange(-6.3, 6.5, 4.2):
            surfaces += structures.smoke_detector((x + rng.uniform(-0.6, 0.6), y, HEIGHT))
            surfaces += structures.sprinkler((x + 1.5, y + 1.05, HEIGHT))
    surfaces += structures.sign((-4.0, -2.2, 2.75), 0.0, "EXIT", 0.7)
    surfaces += structures.sign((5.2, 3.0, 2.75), np.pi / 2, "ROOM 12", 0.8)
    return surfaces


def _furniture(rng: np.random.Generator) -> List[Surface]:
    surfaces: List[Surface] = []
    for x, y in COLUMNS:
        surfaces += box((x, y, HEIGHT / 2), (0.4, 0.4, HEIGHT), materials.CONCRETE)
    for x in np.arange(-9.5, 9.5, 1.0):
        height = rng.uniform(1.2, 2.2)
        surfaces += box((x, CUPBOARDS[1], height / 2), (0.98, 0.5, height), materials.WOOD)
    return surfaces
