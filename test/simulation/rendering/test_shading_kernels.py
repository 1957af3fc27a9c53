# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.simulation.rendering.geometry import quad
from ceiling_dso_ros.simulation.rendering.materials import STEEL
from ceiling_dso_ros.simulation.rendering.scene import build_mesh
from ceiling_dso_ros.simulation.rendering.shading_kernels import Textures, expose

WIDTH, HEIGHT = 80, 60
INTRINSICS = (45.0, 47.0, 38.3, 31.1)
TEXEL_M = 0.1


def textures_of(surfaces, picture):
    """The same picture (rows, columns) on every surface."""
    return Textures(
        texels=np.tile(picture.astype(np.uint16).reshape(-1), len(surfaces)),
        starts=np.arange(len(surfaces), dtype=np.int64) * picture.size,
        shapes=np.array([picture.shape] * len(surfaces), dtype=np.int32),
        origins=np.array([surface.origin for surface in surfaces]),
        axes=np.array([[surface.axis_u, surface.axis_v] for surface in surfaces]) / TEXEL_M,
    )


def paint(surfaces, picture, R, C, offsets, texture_offsets=((0.0, 0.0),)):
    """Expose with one pose and samples at (x, y) offsets within the pixel; gives the radiance and the last surfaces."""
    intrinsics = np.array(
        [(*INTRINSICS[:2], INTRINSICS[2] - x, INTRINSICS[3] - y) for x, y in (*offsets, *texture_offsets)]
    )
    count = len(intrinsics)
    radiance = np.empty((HEIGHT, WIDTH), dtype=np.float32)
    index = np.empty((len(offsets), HEIGHT, WIDTH), dtype=np.int32)
    scene = (build_mesh(surfaces), textures_of(surfaces, picture))
    polygons = np.arange(len(surfaces), dtype=np.int32)
    scratch = np.empty((HEIGHT, WIDTH), dtype=np.float32)
    expose(scene, polygons, np.tile(R, (count, 1, 1)), np.tile(C, (count, 1)), intrinsics, scratch, index, radiance)
    return radiance, index


def rays(R):
    """World directions with z = 1 in the camera, (H, W, 3)."""
    fx, fy, cx, cy = INTRINSICS
    x, y = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    return np.stack([(x - cx) / fx, (y - cy) / fy, np.ones(x.shape)], axis=-1) @ R.T


def test_texture_coordinates_are_those_of_the_plane():
    """A texture that holds its own coordinates, on a tilted surface."""
    surface = quad((-3, -2, 4), (0.3, 7, 0.5), (6, 0, 2.5), STEEL)
    u, v = np.meshgrid(np.arange(71), np.arange(67))
    R = Rotation.from_euler("xyz", [0.1, -0.2, 0.7]).as_matrix()
    C = np.array([0.1, 0.2, 0.3])
    directions = rays(R)
    depth = ((surface.vertices[0] - C) @ surface.normal) / (directions @ surface.normal)
    points = C + depth[..., None] * directions - surface.origin
    for picture, axis in ((u, surface.axis_u), (v, surface.axis_v)):
        radiance, index = paint([surface], 100 * picture, R, C, [(0.0, 0.0)])
        seen = index[0] == 0
        assert seen.mean() > 0.3
        np.testing.assert_allclose(radiance[seen], 100 * (points @ axis / TEXEL_M)[seen], atol=0.05)
        assert (radiance[~seen] == 0).all()


def test_pixels_at_an_edge_are_the_mean_of_their_samples():
    left, right = (quad((x, 9, 2), (9, 0, 0), (0, -18, 0), STEEL) for x in (-9.0, 0.013))
    picture = np.full((190, 100), 1000)
    offsets = [(x, 0.0) for x in (-0.375, -0.125, 0.125, 0.375)]
    radiance, index = paint([left, right], picture, np.eye(3), np.zeros(3), offsets)
    np.testing.assert_allclose(radiance, 1000 * (index >= 0).mean(axis=0), rtol=1e-5)
    assert 0 < (radiance[30] < 999).sum() <= 2, "the gap between the two is narrower than a pixel"


def test_textures_are_gathered_over_their_own_samples():
    surface = quad((-9, 9, 2), (18, 0, 0), (0, -18, 0), STEEL)
    picture = np.tile(np.arange(190) * 100, (190, 1))
    centre, _ = paint([surface], picture, np.eye(3), np.zeros(3), [(0.3, 0.1), (-0.3, -0.1)])
    shifted, _ = paint([surface], picture, np.eye(3), np.zeros(3), [(0.3, 0.1), (-0.3, -0.1)], [(1.0, 0.0), (0.0, 0.0)])
    np.testing.assert_allclose(shifted[:, :-1], (centre[:, 1:] + centre[:, :-1]) / 2, rtol=1e-4)
