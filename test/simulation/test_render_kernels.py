import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.simulation.geometry import box, polygon, quad
from ceiling_dso_ros.simulation.materials import STEEL
from ceiling_dso_ros.simulation.render_kernels import NOTHING, Textures, expose, rasterise, visible_polygons
from ceiling_dso_ros.simulation.scene import build_mesh

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


def test_texture_coordinates_are_those_of_the_plane():
    """A texture that holds its own coordinates, on a tilted surface."""
    surface = quad((-3, -2, 4), (0.3, 7, 0.5), (6, 0, 2.5), STEEL)
    texel_m, columns, rows = 0.1, 71, 67
    u, v = np.meshgrid(np.arange(columns), np.arange(rows))
    mesh = build_mesh([surface])
    R = Rotation.from_euler("xyz", [0.1, -0.2, 0.7]).as_matrix()
    C = np.array([0.1, 0.2, 0.3])
    directions = rays(R)
    depth = ((surface.vertices[0] - C) @ surface.normal) / (directions @ surface.normal)
    points = C + depth[..., None] * directions - surface.origin
    for texture, axis in ((u, surface.axis_u), (v, surface.axis_v)):
        textures = Textures(
            texels=(100 * texture).astype(np.uint16).reshape(-1),
            starts=np.zeros(1, dtype=np.int64),
            shapes=np.array([[rows, columns]], dtype=np.int32),
            origins=surface.origin[None],
            axes=np.stack([surface.axis_u, surface.axis_v])[None] / texel_m,
        )
        radiance = np.empty((HEIGHT, WIDTH), dtype=np.float32)
        index = np.empty((1, HEIGHT, WIDTH), dtype=np.int32)
        scratch = np.empty((HEIGHT, WIDTH), dtype=np.float32)
        expose(
            (mesh, textures), np.zeros(1, np.int32), R[None], C[None], np.array([INTRINSICS]), scratch, index, radiance
        )
        seen = index[0] == 0
        assert seen.mean() > 0.3
        np.testing.assert_allclose(radiance[seen], 100 * (points @ axis / texel_m)[seen], atol=0.05)
        assert (radiance[~seen] == 0).all()
