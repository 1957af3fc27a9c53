# SPDX-License-Identifier: BSD-3-Clause
"""What carries a roof and what hangs below it, drawn at random."""

from typing import Callable, Dict, List, Tuple

import numpy as np

from ceiling_dso_ros.simulation.ceilings.drawn.roofs import Roof
from ceiling_dso_ros.simulation.rendering import materials, structures
from ceiling_dso_ros.simulation.rendering.geometry import Surface, beam, box, quad
from ceiling_dso_ros.simulation.rendering.materials import Material

LOWEST_M = 2.1  # nothing hangs lower
CLOSE_M = 0.03  # gap to the roof
WORDS = ("ZONE", "GATE", "EXIT", "AISLE", "DOCK", "LINE")

Hanging = Callable[[np.random.Generator, Roof, bool], List[Surface]]


def _room_m(roof: Roof) -> float:
    """How far things may hang below the lowest line of the roof."""
    return roof.lowest_m - LOWEST_M


def _level(rng: np.random.Generator, roof: Roof, thick_m: float) -> float:
    """Height of the axis of something as thick that runs through the whole hall."""
    return roof.lowest_m - CLOSE_M - thick_m / 2 - rng.uniform(0.0, max(0.0, min(_room_m(roof) - thick_m, 1.5)))


def _places(rng: np.random.Generator, side_m: float, spacing_m: float, is_periodic: bool) -> np.ndarray:
    """Positions across a hall about so far apart, regular or a little off."""
    places = np.arange(-side_m / 2 + spacing_m / 2, side_m / 2, spacing_m)
    return places if is_periodic else places + rng.uniform(-0.1, 0.1, len(places)) * spacing_m


def _purlins(rng: np.random.Generator, roof: Roof, is_periodic: bool) -> List[Surface]:
    half, depth = roof.size_m[0] / 2, rng.uniform(0.1, 0.22)
    steel = rng.random() < 0.6
    surfaces: List[Surface] = []
    for y in _places(rng, roof.size_m[1], rng.uniform(1.0, 2.2), is_periodic):
        z = roof.height(y) - depth / 2 - CLOSE_M
        ends = (-half, y, z), (half, y, z)
        surfaces += structures.z_purlin(*ends, depth) if steel else beam(*ends, 0.6 * depth, depth, materials.WOOD)
    return surfaces


def _girders(rng: np.random.Generator, roof: Roof, is_periodic: bool) -> List[Surface]:
    half = roof.size_m[1] / 2 - 0.05
    kind = rng.choice(["steel", "concrete", "truss", "timber"])
    depth = min(rng.uniform(0.25, 0.9), max(_room_m(roof), 0.1))
    surfaces: List[Surface] = []
    for x in _places(rng, roof.size_m[0], rng.uniform(3.5, 7.0), is_periodic):
        z = roof.lowest_m - depth / 2 - CLOSE_M
        if kind == "truss":
            top = [(x, y, roof.height(y) - 0.1) for y in np.linspace(-half, half, 12)]
            surfaces += structures.truss((x, -half, z - depth / 2 + 0.05), (x, half, z - depth / 2 + 0.05), top)
        elif kind == "steel":
            surfaces += structures.i_beam((x, -half, z), (x, half, z), depth, 0.5 * depth)
        else:
            material = materials.CONCRETE if kind == "concrete" else materials.WOOD
            surfaces += beam((x, -half, z), (x, half, z), 0.45 * depth, depth, material)
    return surfaces


def _ducts(rng: np.random.Generator, roof: Roof, is_periodic: bool) -> List[Surface]:
    radius = min(rng.uniform(0.12, 0.45), max(_room_m(roof) / 2, 0.08))
    surfaces: List[Surface] = []
    half = roof.size_m[0] / 2 - 0.3
    for y in rng.uniform(-0.4, 0.4, rng.integers(1, 3)) * roof.size_m[1]:
        z = _level(rng, roof, 2 * radius)
        if rng.random() < 0.7:
            surfaces += structures.round_duct([(-half, y, z), (half, y, z)], radius)
        else:
            surfaces += box((0.0, y, z), (2 * half, 2.2 * radius, 1.4 * radius), materials.GALVANISED)
        for x in _places(rng, 2 * half, rng.uniform(2.0, 5.0), is_periodic):
            surfaces += structures.diffuser((x, y, z - radius - 0.1), min(0.3, radius))
    return surfaces


def _pipes(rng: np.random.Generator, roof: Roof, is_periodic: bool) -> List[Surface]:
    """Pipes along and across, one of the rows with sprinklers."""
    surfaces: List[Surface] = []
    (length, width), spacing = roof.size_m, rng.uniform(2.4, 3.6)
    radius = rng.uniform(0.012, 0.03)
    for y in _places(rng, width, rng.uniform(2.5, 4.5), is_periodic):
        z = _level(rng, roof, 2 * radius)
        surfaces += structures.pipe([(-length / 2, y, z), (length / 2, y, z)], radius)
        for x in _places(rng, length, spacing, is_periodic):
            surfaces += structures.sprinkler((x, y, z))
    for x in rng.uniform(-0.45, 0.45, rng.integers(0, 4)) * length:
        z = _level(rng, roof, 0.1)
        surfaces += structures.pipe([(x, -width / 2, z), (x, width / 2, z)], rng.uniform(0.01, 0.05))
    return surfaces


def _trays(rng: np.random.Generator, roof: Roof, is_periodic: bool) -> List[Surface]:
    surfaces: List[Surface] = []
    length, width = roof.size_m
    for along in rng.random(rng.integers(1, 4)) < 0.7:
        z, wide = _level(rng, roof, 0.1), rng.uniform(0.15, 0.5)
        at = rng.uniform(-0.42, 0.42) * (width if along else length)
        ends = [(-length / 2, at, z), (length / 2, at, z)] if along else [(at, -width / 2, z), (at, width / 2, z)]
        surfaces += structures.cable_tray(ends[0], ends[1], wide)
    return surfaces


def _cables(rng: np.random.Generator, roof: Roof, is_periodic: bool) -> List[Surface]:
    """Loose cables that sag between points below the roof."""
    surfaces: List[Surface] = []
    for _ in range(rng.integers(2, 7)):
        a = rng.uniform(-0.45, 0.45, 2) * roof.size_m
        heading, length = rng.uniform(0, 2 * np.pi), rng.uniform(2.0, 6.0)
        b = np.clip(a + length * np.array([np.cos(heading), np.sin(heading)]), *np.outer((-0.48, 0.48), roof.size_m))
        sag, shares = min(rng.uniform(0.05, 0.4), max(_room_m(roof), 0.02)), np.linspace(0.0, 1.0, 9)
        z = roof.lowest_m - CLOSE_M - 0.02 - 4 * sag * shares * (1 - shares)
        points = np.column_stack([a + shares[:, None] * (b - a), z])
        surfaces += structures.pipe(list(points), rng.uniform(0.006, 0.015), materials.BLACK)
    return surfaces


def _hoist(rng: np.random.Generator, roof: Roof, is_periodic: bool) -> List[Surface]:
    """A travelling crane that stands still: two rails, a bridge, a trolley with a hook."""
    half, side = roof.size_m[0] / 2, 0.42 * roof.size_m[1]
    z = roof.lowest_m - 0.5
    if z - 0.9 < LOWEST_M:
        return []
    x, y = rng.uniform(-0.4, 0.4) * roof.size_m[0], rng.uniform(-0.6, 0.6) * side
    surfaces: List[Surface] = []
    for sign in (-1.0, 1.0):
        surfaces += structures.i_beam((-half, sign * side, z - 0.2), (half, sign * side, z - 0.2), 0.3, 0.2)
    yellow = Material(0.55)
    surfaces += beam((x, -side, z), (x, side, z), 0.3, 0.4, yellow)
    surfaces += box((x, y, z - 0.35), (0.7, 0.6, 0.3), yellow)
    return surfaces + structures.pipe([(x, y, z - 0.5), (x, y, z - 0.85)], 0.012, materials.STEEL)


def _banners(rng: np.random.Generator, roof: Roof, is_periodic: bool) -> List[Surface]:
    """Signs that hang, and sheets of cloth."""
    surfaces: List[Surface] = []
    for k in range(rng.integers(2, 8)):
        x, y = rng.uniform(-0.42, 0.42, 2) * roof.size_m
        width = rng.uniform(0.5, 1.6)
        z = max(_level(rng, roof, 0.3 * width), LOWEST_M + 0.15 * width)
        text = f"{rng.choice(WORDS)} {k + 1}"
        surfaces += structures.sign((x, y, z), rng.uniform(0, 2 * np.pi), text, width, rng.uniform(1.8, 2.6))
        surfaces += structures.hangers([(x, y, z + 0.1 * width)], [roof.height(y)])
    return surfaces


def _detectors(rng: np.random.Generator, roof: Roof, is_periodic: bool) -> List[Surface]:
    surfaces: List[Surface] = []
    spacing = rng.uniform(3.0, 7.0)
    for x in _places(rng, roof.size_m[0], spacing, is_periodic):
        for y in _places(rng, roof.size_m[1], spacing, is_periodic):
            surfaces += structures.smoke_detector((x, y, roof.height(y) - CLOSE_M))
    return surfaces


def _outlets(rng: np.random.Generator, roof: Roof, is_periodic: bool) -> List[Surface]:
    surfaces = []
    size = rng.uniform(0.3, 0.6)
    for x in _places(rng, roof.size_m[0], rng.uniform(2.5, 6.0), is_periodic):
        for y in _places(rng, roof.size_m[1], rng.uniform(2.5, 6.0), is_periodic):
            corner = (x, y + size, roof.height(y) - CLOSE_M)
            surfaces.append(quad(corner, (size, 0, 0), (0, -size, 0), materials.OUTLET))
    return surfaces


# Name -> what it makes, and how often it is there.
HANGINGS: Dict[str, Tuple[Hanging, float]] = {
    "purlins": (_purlins, 0.5),
    "girders": (_girders, 0.5),
    "ducts": (_ducts, 0.45),
    "pipes": (_pipes, 0.5),
    "trays": (_trays, 0.4),
    "cables": (_cables, 0.3),
    "hoist": (_hoist, 0.2),
    "banners": (_banners, 0.3),
    "detectors": (_detectors, 0.35),
    "outlets": (_outlets, 0.25),
}
FLUSH = ("detectors", "outlets")  # that fit under a low ceiling
RANDOM = ("cables", "hoist", "banners", "trays", "ducts")  # that break a period
LOW_M = 3.0


def draw_hangings(rng: np.random.Generator, roof: Roof, is_periodic: bool) -> Dict[str, List[Surface]]:
    """What hangs under a roof, by name; under a strictly periodic one only what repeats."""
    drawn = {}
    for name, (make, share) in HANGINGS.items():
        fits = roof.lowest_m >= LOW_M or name in FLUSH
        if rng.random() < share and fits and not (is_periodic and name in RANDOM):
            drawn[name] = make(rng, roof, is_periodic)
    return drawn
