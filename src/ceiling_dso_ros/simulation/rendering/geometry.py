# SPDX-License-Identifier: BSD-3-Clause
"""Surfaces of a building: flat convex polygons with a painted side, and the solids made of them.

World frame: x along the hall, y across it, z up, the origin on the floor in the middle of the hall; metres.
"""

from dataclasses import dataclass
from typing import List, Optional, Sequence, Tuple, Union

import numpy as np

from ceiling_dso_ros.simulation.rendering.materials import Material

Point = Union[Sequence[float], np.ndarray]


@dataclass(eq=False)
class Sheet:
    """A rectangle of one material from which one or more surfaces are cut, so that a pattern continues across edges.

    Attributes:
        material: what is painted on it.
        size_m: (width, height) along the axes u and v of its surfaces.
    """

    material: Material
    size_m: Tuple[float, float]


@dataclass(frozen=True, eq=False)
class Surface:
    """A flat convex polygon that is seen from one side.

    Attributes:
        vertices: (n, 3) world coordinates, counter-clockwise as seen from the visible side.
        axis_u, axis_v: (3,) orthogonal unit vectors in the plane, the directions of the sheet's width and height.
        sheet: what is painted on it.
        offset_m: where on the sheet the polygon's smallest u and v lie.
        edge_normals: (2, 3) unit normals at the smallest and largest v, used for shading; None if the surface is flat.
    """

    vertices: np.ndarray
    axis_u: np.ndarray
    axis_v: np.ndarray
    sheet: Sheet
    offset_m: Tuple[float, float] = (0.0, 0.0)
    edge_normals: Optional[np.ndarray] = None

    @property
    def normal(self) -> np.ndarray:
        """Unit normal of the visible side, (3,)."""
        return _unit(np.cross(self.vertices[1] - self.vertices[0], self.vertices[2] - self.vertices[1]))

    @property
    def origin(self) -> np.ndarray:
        """World point at the polygon's smallest u and v, (3,)."""
        u, v = self.vertices @ self.axis_u, self.vertices @ self.axis_v
        height = self.vertices[0] - u[0] * self.axis_u - v[0] * self.axis_v
        return height + u.min() * self.axis_u + v.min() * self.axis_v

    @property
    def extent_m(self) -> Tuple[float, float]:
        """Extent along u and v, metres."""
        return float(np.ptp(self.vertices @ self.axis_u)), float(np.ptp(self.vertices @ self.axis_v))


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)


def polygon(
    vertices: Union[Sequence[Point], np.ndarray],
    material: Material,
    along: Optional[Point] = None,
    sheet: Optional[Sheet] = None,
    offset_m: Tuple[float, float] = (0.0, 0.0),
) -> Surface:
    """A flat convex polygon, counter-clockwise as seen from its visible side.

    Args:
        vertices: at least three world points.
        material: what it is painted with, when no sheet is given.
        along: direction of u; the first edge if None.
        sheet: the sheet it is cut from; its own if None.
        offset_m: where on that sheet.
    """
    corners = np.array(vertices, dtype=np.float64)
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[1])
    axis_u = corners[1] - corners[0] if along is None else np.array(along, dtype=np.float64)
    axis_u = _unit(axis_u - normal * (normal @ axis_u) / (normal @ normal))
    axis_v = _unit(np.cross(normal, axis_u))
    if sheet is None:
        sheet = Sheet(material, (float(np.ptp(corners @ axis_u)), float(np.ptp(corners @ axis_v))))
    return Surface(corners, axis_u, axis_v, sheet, offset_m)


def quad(corner: Point, edge_u: Point, edge_v: Point, material: Material) -> Surface:
    """The parallelogram corner + [0, 1] edge_u + [0, 1] edge_v, visible from the side of edge_u x edge_v."""
    a, u, v = (np.array(p, dtype=np.float64) for p in (corner, edge_u, edge_v))
    return polygon([a, a + u, a + u + v, a + v], material)


def beam(
    start: Point, end: Point, width: float, height: float, material: Material, up: Point = (0, 0, 1)
) -> List[Surface]:
    """A straight bar of rectangular cross-section; its lower side first, u runs along it on the four long sides.

    Args:
        start: a point on its axis.
        end: another one.
        width: across both the axis and `up`.
        height: along the part of `up` that is perpendicular to the axis.
        material: of all six sides.
        up: any vector that is not along the axis.
    """
    a, b = np.array(start, dtype=np.float64), np.array(end, dtype=np.float64)
    length = b - a
    side = _unit(np.cross(length, np.array(up, dtype=np.float64))) * width
    rise = _unit(np.cross(side, length)) * height
    low = a - side / 2 - rise / 2
    return [
        quad(low, length, side, material),
        quad(low + side, length, rise, material),
        quad(low + side + rise, length, -side, material),
        quad(low + rise, length, -rise, material),
        quad(low, side, rise, material),
        quad(low + length, rise, side, material),
    ]


def box(center: Point, size: Point, material: Material, yaw: float = 0.0) -> List[Surface]:
    """An upright box with sides `size` (x, y, z) turned by yaw radians about z."""
    half = np.array([np.cos(yaw), np.sin(yaw), 0.0]) * size[0] / 2
    middle = np.array(center, dtype=np.float64)
    return beam(middle - half, middle + half, size[1], size[2], material)


def tube(
    start: Point, end: Point, radius: float, material: Material, sides: int = 12, capped: bool = False
) -> List[Surface]:
    """A round bar as a prism whose sides are lit as if it were round; u runs along it and v around it."""
    a, b = np.array(start, dtype=np.float64), np.array(end, dtype=np.float64)
    axis = _unit(b - a)
    right = _unit(np.cross(axis, [0.0, 0.0, 1.0] if abs(axis[2]) < 0.9 else [1.0, 0.0, 0.0]))
    up = np.cross(right, axis)
    angles = np.arange(sides + 1) * 2 * np.pi / sides
    normals = np.outer(np.cos(angles), right) + np.outer(np.sin(angles), up)
    width = 2 * radius * np.sin(np.pi / sides)
    sheet = Sheet(material, (float(np.linalg.norm(b - a)), width * sides))
    surfaces = []
    for k in range(sides):
        p, q = normals[k] * radius, normals[k + 1] * radius
        side = polygon([a + q, a + p, b + p, b + q], material, axis, sheet, (0.0, k * width))
        surfaces.append(Surface(side.vertices, side.axis_u, side.axis_v, sheet, side.offset_m, normals[k : k + 2]))
    if capped:
        surfaces += [polygon(a + normals[:-1] * radius, material), polygon(b + normals[:-1][::-1] * radius, material)]
    return surfaces


def disk(center: Point, normal: Point, radius: float, material: Material, sides: int = 24) -> Surface:
    """A regular polygon of many sides, visible from where its normal points."""
    n = _unit(np.array(normal, dtype=np.float64))
    right = _unit(np.cross(n, [1.0, 0.0, 0.0] if abs(n[0]) < 0.9 else [0.0, 1.0, 0.0]))
    angles = np.arange(sides) * 2 * np.pi / sides
    rim = np.outer(np.cos(angles), right) + np.outer(np.sin(angles), np.cross(n, right))
    return polygon(np.array(center, dtype=np.float64) + radius * rim, material)
