# SPDX-License-Identifier: BSD-3-Clause
"""A painted plaster ceiling at 3.2 m, nearly without texture."""

from typing import List

import numpy as np

from ceiling_dso_ros.simulation.obstacles import Obstacles, person
from ceiling_dso_ros.simulation.rendering import materials, structures
from ceiling_dso_ros.simulation.rendering.geometry import Surface, beam
from ceiling_dso_ros.simulation.rendering.lighting import Source
from ceiling_dso_ros.simulation.rendering.scene import Hall

LENGTH, WIDTH, HEIGHT = 21.0, 15.0, 3.2


def plaster(rng: np.random.Generator) -> Hall:
    """Plaster with roller marks and hairlines, a few lamps and detectors far apart, one shallow beam."""
    a, b = LENGTH / 2, WIDTH / 2
    lamps = [(x + rng.uniform(-0.3, 0.3), y, HEIGHT - 0.25) for x in (-6.6, 0.2, 6.8) for y in (-3.4, 3.4)]
    surfaces: List[Surface] = [
        structures.downward([(-a, -b), (a, -b), (a, b), (-a, b)], HEIGHT, materials.PLASTER),
        *structures.room_walls(LENGTH, WIDTH, HEIGHT, materials.PAINTED_WALL),
        *beam((3.5, -b, HEIGHT - 0.1), (3.5, b, HEIGHT - 0.1), 0.3, 0.2, materials.PLASTER),
    ]
    for x, y, z in lamps:
        surfaces += structures.bay_lamp((x, y, z), 0.16)
    for x, y in ((-8.5, 0.3), (-3.1, -0.4), (2.2, 4.9), (7.5, -0.8), (-1.4, -5.6)):
        surfaces += structures.smoke_detector((x, y, HEIGHT))
    surfaces += structures.pipe([(-a, 5.9, HEIGHT - 0.05), (a, 5.9, HEIGHT - 0.05)], 0.011, materials.WHITE)
    sources = [Source(np.array([x, y, z + 0.05]), 0.08, False) for x, y, z in lamps]
    boxes = [(-8.6, -5.8, 0.5, 0.4), (8.6, 4.0, 0.4, 0.8)]
    obstacles = Obstacles(structures.room_plan(LENGTH, WIDTH, boxes), (person((-7.0, 6.3), (7.0, 6.3)),))
    return Hall(surfaces, sources, (LENGTH, WIDTH), obstacles)
