# SPDX-License-Identifier: BSD-3-Clause
"""The hall of the paper: 21 x 15 m under two inclined planes from 4 m at the eaves to 6 m at the ridge."""

from typing import List

import numpy as np

from ceiling_dso_ros.simulation.obstacles import Obstacles, person, vehicle
from ceiling_dso_ros.simulation.rendering import materials, structures
from ceiling_dso_ros.simulation.rendering.geometry import Surface, beam, polygon, quad
from ceiling_dso_ros.simulation.rendering.lighting import Source
from ceiling_dso_ros.simulation.rendering.scene import Hall

LENGTH, WIDTH = 21.0, 15.0
EAVES, RIDGE = 4.0, 6.0
PURLIN_DEPTH, RAFTER_DEPTH = 0.16, 0.26
FRAMES_X = (-10.3, -5.15, 0.0, 5.15, 10.3)
TRUSSES_X = (-7.7, 2.6, 7.7)


def factory(rng: np.random.Generator) -> Hall:
    """Purlins, rafters, lattice girders, ducts, pipes, cable trays, lamps, skylights and signs; racks at the walls."""
    lamps = _lamp_positions(rng)
    surfaces = _roof(rng) + _steelwork() + _services() + _lamps(lamps) + _signs() + _walls()
    surfaces += structures.rack((-9.0, 6.9), (3.0, 6.9), 0.9, (0.2, 1.4, 2.5), rng)
    surfaces += structures.rack((9.9, -6.0), (9.9, 2.0), 0.9, (0.2, 1.4, 2.4), rng)
    sources = [Source(np.array([x, y, z + 0.05]), 0.22, False) for x, y, z in lamps]
    return Hall(surfaces, sources, (LENGTH, WIDTH), _obstacles())


def roof_height(y: float) -> float:
    """Height of the roof sheets."""
    return RIDGE - (RIDGE - EAVES) * abs(y) / (WIDTH / 2)


def _roof(rng: np.random.Generator) -> List[Surface]:
    half = LENGTH / 2
    surfaces = []
    for side in (-1.0, 1.0):
        eaves, ridge = (-half * side, side * WIDTH / 2, EAVES), (-half * side, 0.0, RIDGE)
        slope = np.subtract(ridge, eaves)
        surfaces.append(quad(eaves, (side * LENGTH, 0, 0), slope, materials.DECK))
        for x in np.arange(-8.9, 9.0, 3.55) + rng.uniform(-0.3, 0.3):
            surfaces += _skylight(x, side, rng.uniform(1.2, 1.8))
    return surfaces


def _skylight(x: float, side: float, length: float) -> List[Surface]:
    """Translucent panel in the roof with a dark frame and two bars."""
    y0, y1 = side * 1.7, side * (1.7 + length)
    surfaces = []
    corners = [(x, y0), (x + 1.0, y0), (x + 1.0, y1), (x, y1)][:: int(-side)]
    surfaces.append(polygon([(u, v, roof_height(v) - 0.01) for u, v in corners], materials.SKYLIGHT))
    for u in (x, x + 0.33, x + 0.67, x + 1.0):
        a, b = (u, y0, roof_height(y0) - 0.02), (u, y1, roof_height(y1) - 0.02)
        surfaces += beam(a, b, 0.04, 0.03, materials.STEEL)
    for y in (y0, y1):
        surfaces += beam(
            (x, y, roof_height(y) - 0.02), (x + 1.0, y, roof_height(y) - 0.02), 0.05, 0.03, materials.STEEL
        )
    return surfaces


def _steelwork() -> List[Surface]:
    half = LENGTH / 2
    surfaces: List[Surface] = []
    for side in (-1.0, 1.0):
        for y in side * np.array([0.35, 1.6, 3.6, 5.0, 6.3, 7.3]):
            z = roof_height(y) - PURLIN_DEPTH / 2 - 0.02
            surfaces += structures.z_purlin((-half, y, z), (half, y, z), PURLIN_DEPTH)
        drop = PURLIN_DEPTH + RAFTER_DEPTH / 2 + 0.02
        for x in FRAMES_X:
            foot = (x, side * WIDTH / 2, EAVES - drop)
            surfaces += structures.i_beam(foot, (x, 0.0, RIDGE - drop), RAFTER_DEPTH, 0.16)
            haunch = [
                (x, side * 7.5, EAVES - 0.9),
                (x, side * 7.5, EAVES - drop),
                (x, side * 6.0, roof_height(6.0) - drop - 0.12),
            ]
            surfaces += [polygon(haunch, materials.STEEL), polygon(haunch[::-1], materials.STEEL)]
            surfaces += beam(
                (x, side * 7.4, 0.0), (x, side * 7.4, EAVES), 0.2, 0.2, materials.BOLTED_STEEL, up=(1, 0, 0)
            )
    for x in TRUSSES_X:
        chord = [(x, y, roof_height(y) - PURLIN_DEPTH - 0.08) for y in np.linspace(-7.3, 7.3, 12)]
        surfaces += structures.truss((x, -7.4, 3.75), (x, 7.4, 3.75), chord)
    return surfaces + _bracing()


def _bracing() -> List[Surface]:
    """Crossed rods in the roof plane of three bays."""
    surfaces: List[Surface] = []
    for x0, x1 in ((FRAMES_X[0], FRAMES_X[1]), (FRAMES_X[1], FRAMES_X[2]), (FRAMES_X[3], FRAMES_X[4])):
        for side in (-1.0, 1.0):
            near, far = side * 0.5, side * 6.9
            low, high = roof_height(far) - 0.25, roof_height(near) - 0.25
            surfaces += structures.pipe([(x0, near, high), (x1, far, low)], 0.014, materials.STEEL)
            surfaces += structures.pipe([(x0, far, low), (x1, near, high)], 0.014, materials.STEEL)
    return surfaces


def _services() -> List[Surface]:
    """Ducts, pipes and cables."""
    surfaces = structures.round_duct([(-10.4, 2.9, 4.25), (6.2, 2.9, 4.25), (6.2, -4.4, 4.25)], 0.3)
    surfaces += structures.round_duct([(-3.4, 2.9, 4.25), (-3.4, 6.4, 3.7)], 0.16)
    for x in (-8.5, -5.8, -1.6, 1.2, 4.0):
        surfaces += structures.diffuser((x, 2.9, 3.98))
    points = [(x, y, 4.5) for x in np.arange(-9.5, 6.0, 2.4) for y in (2.62, 3.18)]
    surfaces += structures.hangers(points, [roof_height(y) - 0.1 for _, y, _ in points])
    surfaces += structures.cable_tray((-10.4, -2.5, 4.55), (10.4, -2.5, 4.55), 0.3)
    surfaces += structures.cable_tray((-1.4, -7.3, 3.62), (-1.4, 2.0, 3.62), 0.2)
    points = [(x, y, 4.6) for x in np.arange(-9.0, 10.0, 3.0) for y in (-2.64, -2.36)]
    surfaces += structures.hangers(points, [roof_height(y) - 0.1 for _, y, _ in points])
    surfaces += structures.pipe([(8.9, -7.4, 3.6), (8.9, 7.4, 3.6)], 0.055)
    for y in (-5.6, -0.9, 4.3):
        surfaces += structures.pipe([(8.9, y, 3.62), (-10.4, y, 3.62 + 0.02)], 0.021)
        for x in np.arange(-9.4, 8.5, 2.7):
            surfaces += structures.sprinkler((x, y, 3.62))
    for x in FRAMES_X[1:4]:
        ends = [(x + 0.12, y, roof_height(y) - 0.47) for y in (-7.2, 0.0, 7.2)]
        surfaces += structures.pipe(ends, 0.011, materials.WHITE)
    return surfaces


def _lamp_positions(rng: np.random.Generator) -> np.ndarray:
    """Centres of the tube lamps (in two rows) and bay lamps (under the ridge), (n, 3)."""
    tubes = [(x, y, 3.85) for y in (-4.9, 4.9) for x in np.arange(-8.8, 9.5, 3.5)]
    bays = [(x, 0.25, 4.7) for x in np.arange(-8.4, 9.0, 4.2)]
    positions = np.array(tubes + bays)
    return positions + rng.uniform(-0.15, 0.15, positions.shape) * (1.0, 1.0, 0.0)


def _lamps(positions: np.ndarray) -> List[Surface]:
    surfaces: List[Surface] = []
    for x, y, z in positions:
        if abs(y) > 1.0:
            surfaces += structures.tube_lamp((x, y, z), 0.0)
            points = [(x - 0.6, y, z), (x + 0.6, y, z)]
        else:
            surfaces += structures.bay_lamp((x, y, z))
            points = [(x, y, z + 0.3)]
        surfaces += structures.hangers(points, [roof_height(y) - 0.1] * len(points))
    return surfaces


def _signs() -> List[Surface]:
    texts = [
        ("ZONE A1", -6.5, 1.3),
        ("ZONE A2", 0.6, 1.3),
        ("GATE 3", 7.0, -1.6),
        ("ZONE B1", -5.0, -3.7),
        ("EXIT", 4.0, -6.2),
    ]
    surfaces: List[Surface] = []
    for k, (text, x, y) in enumerate(texts):
        surfaces += structures.sign((x, y, 3.7), 0.5 * np.pi * k, text)
        surfaces += structures.hangers([(x - 0.1, y, 3.8), (x + 0.1, y, 3.8)], [roof_height(y)] * 2)
    return surfaces


def _walls() -> List[Surface]:
    a, b = LENGTH / 2, WIDTH / 2
    surfaces = [
        structures.wall((-a, -b), (a, -b), EAVES, materials.CLADDING),
        structures.wall((a, b), (-a, b), EAVES, materials.CLADDING),
    ]
    for x, y in ((-a, b), (a, -b)):
        gable = [(x, -y, 0.0), (x, y, 0.0), (x, y, EAVES), (x, 0.0, RIDGE), (x, -y, EAVES)]
        surfaces.append(polygon(gable, materials.CLADDING))
    for x in np.arange(-9.0, 9.0, 3.5):
        surfaces.append(quad((x, -b + 0.01, 2.4), (2.0, 0, 0), (0, 0, 1.1), materials.SKYLIGHT))
        surfaces += beam((x, -b + 0.02, 2.4), (x + 2.0, -b + 0.02, 2.4), 0.04, 0.06, materials.STEEL)
        surfaces += beam(
            (x + 1.0, -b + 0.02, 2.4), (x + 1.0, -b + 0.02, 3.5), 0.04, 0.04, materials.STEEL, up=(0, 1, 0)
        )
    return surfaces


def _obstacles() -> Obstacles:
    columns = [(x, y, 0.1, 0.1) for x in FRAMES_X for y in (-7.4, 7.4)]
    racks = [(-3.0, 6.9, 6.0, 0.45), (9.9, -2.0, 0.45, 4.0)]
    pallets = [(-8.6, -5.7, 0.6, 0.4), (7.1, -6.5, 0.6, 0.4)]
    movers = (person((-8.0, 5.8), (8.0, 5.8)), vehicle((8.4, -5.0), (8.4, 4.5)))
    return Obstacles(structures.room_plan(LENGTH, WIDTH, columns + racks + pallets), movers)
