# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.simulation.rendering.geometry import box, polygon, quad
from ceiling_dso_ros.simulation.rendering.materials import STEEL
from ceiling_dso_ros.simulation.rendering.raster_kernels import NOTHING, rasterise, visible_polygons
from ceiling_dso_ros.simulation.rendering.scene import build_mesh

WIDTH, HEIGHT = 80, 60
INTRINSICS = (45.0, 47.0, 38.3, 31.1)


def pixels():
    x, y = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    return x, y


def rays(R):
    """World directions with z = 1 in the camera, (H, W, 3)."""
    fx, fy, cx, cy = INTRINSICS
    x, y = pixels()
    return np.stack([(x - cx) / fx, (y - cy) / fy, np.ones_like(x, dtype=float)], axis=-1) @ R.T


def cast(surfaces, R, C):
    """Reference: every ray against every polygon. Inverse depth and index."""
    nearest = np.zeros((HEIGHT, WIDTH))
    index = np.full((HEIGHT, WIDTH), NOTHING)
    directions = rays(R)
    for p, surface in enumerate(surfaces):
        n, vertices = surface.normal, surface.vertices
        slope = directions @ n
        depth = ((vertices[0] - C) @ n) / slope
        points = C + depth[..., None] * directions
        inside = (slope < 0) & (depth > 0)
        for a, b in zip(vertices, np.roll(vertices, -1, axis=0)):
            inside &= (points - a) @ np.cross(n, b - a) >= 0
        closer = inside & (1 / depth > nearest)
        nearest[closer], index[closer] = (1 / depth)[closer], p
    return nearest, index


def draw(surfaces, R, C):
    mesh = build_mesh(surfaces)
    inverse_depth = np.empty((HEIGHT, WIDTH), dtype=np.float32)
    index = np.empty((HEIGHT, WIDTH), dtype=np.int32)
    polygons = visible_polygons(mesh, R, C, INTRINSICS, WIDTH, HEIGHT, 0.0)
    rasterise(mesh, polygons, R, C, INTRINSICS, inverse_depth, index)
    return inverse_depth, index


@pytest.mark.parametrize("seed", range(20))
def test_rasterising_agrees_with_ray_casting(seed):
    """Random boxes all around the camera, which has some of their corners behind it."""
    rng = np.random.default_rng(seed)
    R = Rotation.random(random_state=seed).as_matrix()
    C = rng.uniform(-1, 1, 3)
    surfaces = [
        s for _ in range(12) for s in box(rng.uniform(-4, 4, 3), rng.uniform(0.2, 4, 3), STEEL, rng.uniform(0, 6))
    ]
    surfaces = [s for s in surfaces if abs((C - s.vertices[0]) @ s.normal) > 1e-3]

    expected, expected_index = cast(surfaces, R, C)
    inverse_depth, index = draw(surfaces, R, C)
    same = index == expected_index
    assert same.mean() > 0.999  # a pixel centre may lie on an edge
    np.testing.assert_allclose(inverse_depth[same], expected[same], rtol=1e-4, atol=1e-6)


def test_neighbours_leave_no_gap_and_do_not_overlap():
    """A fan of thin triangles around the image's middle: every pixel belongs to exactly one."""
    angles = np.linspace(0, 2 * np.pi, 301)
    rim = np.stack([9 * np.cos(angles), 9 * np.sin(angles), np.full(301, 3.0)], axis=1)
    fan = [polygon([(0.1, 0.2, 3.0), b, a], STEEL) for a, b in zip(rim[:-1], rim[1:])]
    counts = np.zeros((HEIGHT, WIDTH), dtype=int)
    for triangle in fan:
        counts += draw([triangle], np.eye(3), np.zeros(3))[1] != NOTHING
    assert (counts == 1).all()


def test_the_back_of_a_polygon_is_not_seen():
    front = quad((-1, -1, 2), (0, 2, 0), (2, 0, 0), STEEL)
    back = quad((-1, -1, 2), (2, 0, 0), (0, 2, 0), STEEL)
    assert (draw([front], np.eye(3), np.zeros(3))[1] == 0).any()
    assert (draw([back], np.eye(3), np.zeros(3))[1] == NOTHING).all()
