# SPDX-License-Identifier: BSD-3-Clause
"""Structures under ceilings: steelwork, ducts, pipes, cable trays, lamps, signs. Metres, world frame with z up."""

from typing import List, Sequence

import numpy as np

from ceiling_dso_ros.simulation.rendering import materials
from ceiling_dso_ros.simulation.rendering.geometry import Point, Surface, beam, box, disk, polygon, quad, tube
from ceiling_dso_ros.simulation.rendering.materials import Material

Surfaces = List[Surface]


def i_beam(
    start: Point, end: Point, depth: float, width: float, material: Material = materials.BOLTED_STEEL
) -> Surfaces:
    """Rolled I-section: two flanges and a web; start and end lie on its axis."""
    a, b = np.array(start, dtype=float), np.array(end, dtype=float)
    side = np.cross(b - a, [0.0, 0.0, 1.0])
    rise = np.cross(side, b - a)
    rise *= (depth - 0.015) / 2 / np.linalg.norm(rise)
    flanges = beam(a - rise, b - rise, width, 0.015, material) + beam(a + rise, b + rise, width, 0.015, material)
    return flanges + beam(a, b, 0.012, depth - 0.03, material)


def z_purlin(start: Point, end: Point, depth: float, material: Material = materials.GALVANISED) -> Surfaces:
    """Cold-formed Z-section that carries the roof sheets; start and end lie on its axis."""
    a, b = np.array(start, dtype=float), np.array(end, dtype=float)
    side = np.cross(b - a, [0.0, 0.0, 1.0])
    side *= 0.03 / np.linalg.norm(side)
    low = np.array([0.0, 0.0, -depth / 2])
    return beam(a, b, 0.006, depth, material) + beam(a + low + side, b + low + side, 0.06, 0.006, material)


def truss(start: Point, end: Point, top: Sequence[Point], material: Material = materials.LIGHT_STEEL) -> Surfaces:
    """Lattice girder: a straight bottom chord and diagonals up to the points of its top chord."""
    a, b = np.array(start, dtype=float), np.array(end, dtype=float)
    upper = np.array(top, dtype=float)
    lower = [a + (b - a) * (k + 0.5) / (len(upper) - 1) for k in range(len(upper) - 1)]
    surfaces = beam(a, b, 0.10, 0.10, material)
    for p, q in zip(upper[:-1], upper[1:]):
        surfaces += beam(p, q, 0.09, 0.09, material)
    for k, p in enumerate(lower):
        surfaces += beam(p, upper[k], 0.045, 0.045, material) + beam(p, upper[k + 1], 0.045, 0.045, material)
    return surfaces


def cable_tray(start: Point, end: Point, width: float) -> Surfaces:
    """Ladder tray with cables on its rungs, seen from below."""
    a, b = np.array(start, dtype=float), np.array(end, dtype=float)
    length = float(np.linalg.norm(b - a))
    along = (b - a) / length
    side = np.cross([0.0, 0.0, 1.0], along) * width / 2
    surfaces = beam(a + side, b + side, 0.02, 0.07, materials.GALVANISED)
    surfaces += beam(a - side, b - side, 0.02, 0.07, materials.GALVANISED)
    bed = a + np.array([0.0, 0.0, 0.01])
    surfaces.append(quad(bed + 0.9 * side, along * length, -1.8 * side, materials.CABLES))
    for distance in np.arange(0.15, length, 0.3):
        rung = a + along * distance - [0.0, 0.0, 0.02]
        surfaces += beam(rung - side, rung + side, 0.03, 0.02, materials.GALVANISED)[:1]
    return surfaces


def round_duct(points: Sequence[Point], radius: float) -> Surfaces:
    """Spiral duct through the points, with a collar at each end and bend."""
    surfaces: Surfaces = []
    corners = np.array(points, dtype=float)
    for p, q in zip(corners[:-1], corners[1:]):
        surfaces += tube(p, q, radius, materials.DUCT, sides=16, capped=True)
        along = (q - p) / np.linalg.norm(q - p)
        for end, sign in ((p, 1.0), (q, -1.0)):
            surfaces += tube(
                end + sign * 0.02 * along, end + sign * 0.08 * along, radius * 1.06, materials.GALVANISED, 16
            )
    return surfaces


def diffuser(center: Point, size: float = 0.3) -> Surfaces:
    """Air outlet: a short box with a dark grille below."""
    x, y, z = center
    grille = quad((x - 0.4 * size, y + 0.4 * size, z - 0.101), (0.8 * size, 0, 0), (0, -0.8 * size, 0), materials.BLACK)
    return [*box(center, (size, size, 0.2), materials.GALVANISED), grille]


def pipe(points: Sequence[Point], radius: float, material: Material = materials.LIGHT_STEEL) -> Surfaces:
    """Pipe through the points."""
    surfaces: Surfaces = []
    for p, q in zip(points[:-1], points[1:]):
        surfaces += tube(p, q, radius, material, sides=8)
    return surfaces


def sprinkler(point: Point) -> Surfaces:
    """Sprinkler head below a point of its pipe."""
    x, y, z = point
    return [
        *tube((x, y, z - 0.09), (x, y, z), 0.012, materials.BRASS, 6),
        disk((x, y, z - 0.09), (0, 0, -1), 0.03, materials.BRASS, 8),
    ]


def hangers(points: Sequence[Point], heights: Sequence[float], radius: float = 0.006) -> Surfaces:
    """Thin rods from points straight up to the given heights."""
    surfaces: Surfaces = []
    for (x, y, z), top in zip(points, heights):
        surfaces += tube((x, y, z), (x, y, top), radius, materials.STEEL, sides=4)
    return surfaces


def tube_lamp(center: Point, yaw: float, length: float = 1.5, lamp: Material = materials.LAMP) -> Surfaces:
    """Luminaire with two fluorescent tubes under a white tray."""
    middle = np.array(center, dtype=float)
    along = np.array([np.cos(yaw), np.sin(yaw), 0.0]) * length / 2
    side = np.array([-np.sin(yaw), np.cos(yaw), 0.0]) * 0.055
    surfaces = box(middle + np.array([0, 0, 0.05]), (length, 0.2, 0.04), materials.WHITE, yaw)
    for sign in (-1.0, 1.0):
        surfaces += tube(middle + sign * side - along, middle + sign * side + along, 0.014, lamp, 8, capped=True)
    return surfaces


def bay_lamp(center: Point, radius: float = 0.22, lamp: Material = materials.LAMP) -> Surfaces:
    """Round high-bay lamp: a dark housing, a bright ring and a disk that saturates."""
    x, y, z = center
    housing = tube((x, y, z), (x, y, z + 0.18), radius, materials.STEEL, sides=20)
    neck = tube((x, y, z + 0.18), (x, y, z + 0.35), 0.4 * radius, materials.STEEL, sides=10)
    return [*housing, *neck, disk(center, (0, 0, -1), radius * 0.93, lamp), *_ring(center, radius)]


def _ring(center: Point, radius: float) -> Surfaces:
    x, y, z = center
    return [disk((x, y, z + 0.003), (0, 0, -1), radius, materials.WHITE)]


def panel_lamp(corner: Point, size_x: float, size_y: float, lamp: Material = materials.LOUVRE) -> Surfaces:
    """Flush office lamp: a white frame and a bright louvre."""
    x, y, z = corner
    inset = 0.04
    frame = quad((x, y + size_y, z - 0.004), (size_x, 0, 0), (0, -size_y, 0), materials.WHITE)
    louvre = quad(
        (x + inset, y + size_y - inset, z - 0.006),
        (size_x - 2 * inset, 0, 0),
        (0, -size_y + 2 * inset, 0),
        lamp,
    )
    return [frame, louvre]


def sign(center: Point, yaw: float, text: str, width: float = 1.2, tilt: float = 2.2) -> Surfaces:
    """Hanging board with letters; tilt (radians from lying face up) lets it be read from below."""
    along = np.array([np.cos(yaw), np.sin(yaw), 0.0]) * width
    across = np.array([-np.sin(yaw) * np.cos(tilt), np.cos(yaw) * np.cos(tilt), np.sin(tilt)]) * width / 4
    corner = np.array(center, dtype=float) - along / 2 - across / 2
    return [quad(corner, along, across, materials.lettering(text))]


def smoke_detector(center: Point) -> Surfaces:
    """Small white cylinder under a ceiling."""
    x, y, z = center
    return [
        *tube((x, y, z - 0.05), (x, y, z), 0.05, materials.WHITE, 12),
        disk((x, y, z - 0.05), (0, 0, -1), 0.05, materials.WHITE, 12),
        disk((x, y, z - 0.051), (0, 0, -1), 0.018, materials.BLACK, 8),
    ]


def rack(start: Point, end: Point, depth: float, levels: Sequence[float], rng: np.random.Generator) -> Surfaces:
    """Pallet rack between two floor points: uprights, shelves and a random load of boxes."""
    a, b = np.array([*start[:2], 0.0]), np.array([*end[:2], 0.0])
    length = float(np.linalg.norm(b - a))
    along = (b - a) / length
    across = np.cross([0.0, 0.0, 1.0], along)
    yaw = float(np.arctan2(along[1], along[0]))
    top = max(levels) + 1.1
    surfaces: Surfaces = []
    for distance in np.linspace(0.0, length, max(2, round(length / 2.7) + 1)):
        for side in (-0.5, 0.5):
            foot = a + along * distance + across * depth * side
            surfaces += beam(foot, foot + np.array([0.0, 0.0, top]), 0.08, 0.08, materials.STEEL, up=along)
    for level in levels:
        for side in (-0.5, 0.5):
            shift = across * depth * side + [0.0, 0.0, level]
            surfaces += beam(a + shift, b + shift, 0.05, 0.11, materials.LIGHT_STEEL)
        distance = 0.2
        while distance < length - 1.0:
            width, height = rng.uniform(0.6, 1.1), rng.uniform(0.4, 0.95)
            middle = a + along * (distance + width / 2) + [0.0, 0.0, level + 0.07 + height / 2]
            if rng.random() < 0.8:
                surfaces += box(middle, (width, depth * rng.uniform(0.7, 1.0), height), materials.CARDBOARD, yaw)
            distance += width + rng.uniform(0.1, 0.5)
    return surfaces


def room_walls(length: float, width: float, height: float, material: Material) -> Surfaces:
    """Four walls around the origin."""
    return [wall(a, b, height, material) for a, b in _outline(length, width)]


def wall(start: Point, end: Point, height: float, material: Material) -> Surface:
    """Upright wall that is seen from the left of start -> end, points x, y."""
    a, b = np.array([*start[:2], 0.0]), np.array([*end[:2], 0.0])
    return quad(b, a - b, (0.0, 0.0, height), material)


def floor(length: float, width: float) -> Surface:
    """Concrete floor around the origin."""
    return quad((-length / 2, -width / 2, 0.0), (length, 0.0, 0.0), (0.0, width, 0.0), materials.FLOOR)


def downward(corners_xy: Sequence[Sequence[float]], z: float, material: Material) -> Surface:
    """Level ceiling over the counter-clockwise corners (x, y)."""
    return polygon([(x, y, z) for x, y in corners_xy][::-1], material)


def room_plan(length: float, width: float, boxes: Sequence[Sequence[float]] = ()) -> np.ndarray:
    """Segments (n, 2, 2) in x, y that a laser scanner sees: walls, and boxes (center x, center y, half x, half y)."""
    outlines = [np.array([x, y]) + _outline(2 * half_x, 2 * half_y) for x, y, half_x, half_y in boxes]
    return np.concatenate([np.array(_outline(length, width)), *outlines])


def _outline(length: float, width: float) -> List[Sequence[Sequence[float]]]:
    """Sides of a rectangle around the origin, counter-clockwise: pairs of corners (x, y)."""
    a, b = length / 2, width / 2
    corners = [(-a, -b), (a, -b), (a, b), (-a, b)]
    return list(zip(corners, [*corners[1:], corners[0]]))
