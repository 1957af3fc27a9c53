# SPDX-License-Identifier: BSD-3-Clause
"""Kernels that find the visible polygon of each pixel: flat polygons, a pinhole camera, exact at every pixel centre.

For the plane n.X = d and a pixel p = (x, y, 1) with the viewing ray R K^-1 p from the centre C, the inverse depth is
w = n.(R K^-1 p) / (d - n.C), which is affine in the pixel: a polygon costs one multiplication per pixel.

Everywhere R (3, 3) holds the axes of the camera in the world and C (3,) its centre, so T_world_camera = [R C].
"""

from typing import NamedTuple, Tuple

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel, kernel_noalias

f32 = np.float32
Intrinsics = Tuple[float, float, float, float]  # fx fy cx cy in pixels
NOTHING = -1
BEHIND = 1e-3  # metres in front of the camera from which a vertex counts as visible


class Mesh(NamedTuple):
    """Polygons as arrays: P polygons, V vertices in all; world coordinates in metres.

    Attributes:
        vertices: (V, 3) float64, one polygon after the other, counter-clockwise seen from the front.
        first: (P + 1,) int32, where each polygon's vertices begin.
        normals, offsets: (P, 3) and (P,) float64, the planes n.X = d.
        centers, radii: (P, 3) and (P,) float64, bounding spheres.
    """

    vertices: np.ndarray
    first: np.ndarray
    normals: np.ndarray
    offsets: np.ndarray
    centers: np.ndarray
    radii: np.ndarray


@kernel
def visible_polygons(
    mesh: Mesh, R: np.ndarray, C: np.ndarray, intrinsics: Intrinsics, width: int, height: int, margin: float
) -> np.ndarray:
    """Indices of the polygons that may be visible from (R, C) when it moves by up to `margin` metres, (n,) int32."""
    fx, fy, cx, cy = intrinsics
    found = np.empty(len(mesh.radii), np.int32)
    count = 0
    for p in range(len(mesh.radii)):
        n, c, reach = mesh.normals[p], mesh.centers[p], mesh.radii[p] + margin
        if n[0] * C[0] + n[1] * C[1] + n[2] * C[2] < mesh.offsets[p] - margin:
            continue
        dx, dy, dz = c[0] - C[0], c[1] - C[1], c[2] - C[2]
        x = R[0, 0] * dx + R[1, 0] * dy + R[2, 0] * dz
        y = R[0, 1] * dx + R[1, 1] * dy + R[2, 1] * dz
        z = R[0, 2] * dx + R[1, 2] * dy + R[2, 2] * dz
        if (
            z > -reach
            and _beside(x, z, fx, cx + 1.0) < reach
            and _beside(-x, z, fx, width - cx) < reach
            and _beside(y, z, fy, cy + 1.0) < reach
            and _beside(-y, z, fy, height - cy) < reach
        ):
            found[count] = p
            count += 1
    return found[:count]


@kernel
def _beside(x: float, z: float, focal: float, edge: float) -> float:
    """Distance of a point outside the frustum's side plane focal * x = -edge * z; negative inside."""
    return -(focal * x + edge * z) / np.sqrt(focal * focal + edge * edge)


@kernel
def rasterise(
    mesh: Mesh,
    polygons: np.ndarray,
    R: np.ndarray,
    C: np.ndarray,
    intrinsics: Intrinsics,
    inverse_depth: np.ndarray,
    surface: np.ndarray,
) -> None:
    """Find the nearest of the polygons at every pixel centre.

    Args:
        mesh: Mesh.
        polygons: (n,) int32 indices.
        R: (3, 3) float64.
        C: (3,) float64.
        intrinsics: fx, fy, cx, cy in pixels.
        inverse_depth: (H, W) float32, output: 1/z in 1/m along the optical axis, 0 where there is nothing.
        surface: (H, W) int32, output: index of the polygon, NOTHING where there is none.
    """
    inverse_depth[:] = f32(0)
    surface[:] = NOTHING
    height, width = surface.shape
    longest = np.max(mesh.first[1:] - mesh.first[:-1])
    corners, sides = np.empty((longest, 3)), np.empty((longest, 3))
    for p in polygons:
        wx, wy, w1, facing = inverse_depth_plane(mesh.normals[p], mesh.offsets[p], R, C, intrinsics)
        if not facing:
            continue
        count = mesh.first[p + 1] - mesh.first[p]
        top, bottom = _project(mesh.vertices[mesh.first[p] : mesh.first[p + 1]], R, C, intrinsics, height, corners)
        _side_lines(corners, count, sides)
        for y in range(top, bottom):
            start, end = _span(sides, count, y, width)
            if start < end:
                _fill(inverse_depth[y, start:end], surface[y, start:end], f32(w1 + wy * y), f32(wx), start, p)


@kernel
def inverse_depth_plane(
    n: np.ndarray, d: float, R: np.ndarray, C: np.ndarray, intrinsics: Intrinsics
) -> Tuple[float, float, float, bool]:
    """Coefficients of 1/z = wx x + wy y + w1 on the plane n.X = d, and whether its front faces the camera."""
    distance = d - (n[0] * C[0] + n[1] * C[1] + n[2] * C[2])
    if distance > -1e-9:
        return 0.0, 0.0, 0.0, False
    wx, wy, w1 = ray_product(n, R, intrinsics)
    return wx / distance, wy / distance, w1 / distance, True


@kernel
def ray_product(a: np.ndarray, R: np.ndarray, intrinsics: Intrinsics) -> Tuple[float, float, float]:
    """Coefficients (x, y, 1) of the product of a world vector and a pixel's viewing ray R K^-1 p."""
    fx, fy, cx, cy = intrinsics
    ax = (R[0, 0] * a[0] + R[1, 0] * a[1] + R[2, 0] * a[2]) / fx
    ay = (R[0, 1] * a[0] + R[1, 1] * a[1] + R[2, 1] * a[2]) / fy
    az = R[0, 2] * a[0] + R[1, 2] * a[1] + R[2, 2] * a[2]
    return ax, ay, az - ax * cx - ay * cy


@kernel
def _project(
    vertices: np.ndarray, R: np.ndarray, C: np.ndarray, intrinsics: Intrinsics, height: int, corners: np.ndarray
) -> Tuple[int, int]:
    """Homogeneous pixels of the vertices into `corners`; returns the range of rows they cover."""
    fx, fy, cx, cy = intrinsics
    low, high, behind = 1e9, -1e9, False
    for i in range(len(vertices)):
        dx, dy, dz = vertices[i, 0] - C[0], vertices[i, 1] - C[1], vertices[i, 2] - C[2]
        z = R[0, 2] * dx + R[1, 2] * dy + R[2, 2] * dz
        corners[i, 0] = fx * (R[0, 0] * dx + R[1, 0] * dy + R[2, 0] * dz) + cx * z
        corners[i, 1] = fy * (R[0, 1] * dx + R[1, 1] * dy + R[2, 1] * dz) + cy * z
        corners[i, 2] = z
        if z < BEHIND:
            behind = True
        else:
            low, high = min(low, corners[i, 1] / z), max(high, corners[i, 1] / z)
    if behind:
        return 0, height
    return int(np.ceil(min(max(low, 0.0), float(height)))), int(np.ceil(min(max(high, 0.0), float(height))))


@kernel
def _side_lines(corners: np.ndarray, count: int, sides: np.ndarray) -> None:
    """Lines e.(x, y, 1) >= 0 inside: e = q_i+1 x q_i of homogeneous pixels, also for vertices behind the camera."""
    for i in range(count):
        a, b = corners[i], corners[(i + 1) % count]
        sides[i, 0] = a[2] * b[1] - a[1] * b[2]
        sides[i, 1] = a[0] * b[2] - a[2] * b[0]
        sides[i, 2] = a[1] * b[0] - a[0] * b[1]


@kernel
def _span(sides: np.ndarray, count: int, y: int, width: int) -> Tuple[int, int]:
    """Pixels [start, end) of row y whose centres lie inside; neighbours with a common side leave no gap."""
    low, high = 0.0, float(width)
    for i in range(count):
        a, rest = sides[i, 0], sides[i, 1] * y + sides[i, 2]
        if a > 0.0:
            low = max(low, -rest / a)
        elif a < 0.0:
            high = min(high, -rest / a)
        elif rest < 0.0:
            return 0, 0
    if not low < high:
        return 0, 0
    return int(np.ceil(low)), int(np.ceil(high))


@kernel_noalias
def _fill(inverse_depth: np.ndarray, surface: np.ndarray, w: np.float32, wx: np.float32, start: int, p: int) -> None:
    for i in range(surface.size):
        here = w + wx * f32(start + i)
        nearer = here > inverse_depth[i]
        inverse_depth[i] = here if nearer else inverse_depth[i]
        surface[i] = p if nearer else surface[i]
