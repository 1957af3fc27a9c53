# SPDX-License-Identifier: BSD-3-Clause
"""Sizes, means and intrinsics of the levels."""

import numpy as np
import pytest

from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.dso.geometry.projection import level_intrinsics
from ceiling_dso_ros.dso.images.interpolation import sample
from ceiling_dso_ros.dso.images.pyramid import PyramidPool, PyramidShape

CAMERA = PinholeCamera(200.0, 210.0, 151.0, 117.0, 320, 240)


@pytest.mark.parametrize(
    ("size", "sizes"),
    [
        ((848, 480), ((848, 480), (424, 240), (212, 120), (106, 60), (53, 30))),
        ((424, 240), ((424, 240), (212, 120), (106, 60), (53, 30))),
        ((640, 480), ((640, 480), (320, 240), (160, 120), (80, 60))),
        ((321, 240), ((321, 240),)),
        ((64, 64), ((64, 64),)),
        ((8192, 8192), tuple((8192 >> k, 8192 >> k) for k in range(6))),
    ],
)
def test_sizes(size, sizes):
    shape = PyramidShape.of(*size)
    assert shape.sizes == sizes
    assert shape.levels == len(sizes)
    assert shape.offsets == tuple(np.cumsum([0] + [w * h for w, h in sizes]))


def test_each_level_is_the_mean_of_four_pixels():
    image = np.random.default_rng(0).integers(0, 256, (240, 320)).astype(np.uint8)
    pool = PyramidPool(CAMERA, 2)
    slot = pool.build(image)
    expected = image.astype(np.float64)
    for level, (width, height) in enumerate(pool.shape.sizes):
        np.testing.assert_allclose(pool.level(slot, level).reshape(height, width), expected, rtol=1e-6)
        expected = expected.reshape(height // 2, 2, width // 2, 2).mean(axis=(1, 3))


def test_slots_are_independent_and_come_back():
    pool = PyramidPool(CAMERA, 2)
    a, b = pool.build(np.full((240, 320), 10, np.uint8)), pool.build(np.full((240, 320), 20, np.uint8))
    assert a != b
    assert (pool.level(a, 2) == 10).all()
    assert (pool.level(b, 2) == 20).all()
    pool.release(a)
    assert pool.build(np.full((240, 320), 30, np.uint8)) == a
    assert (pool.level(b, 0) == 20).all()


def test_all_slots_come_back_at_once():
    pool = PyramidPool(CAMERA, 3)
    black = np.zeros((240, 320), np.uint8)
    for _ in range(3):
        assert {pool.build(black) for _ in range(3)} == {0, 1, 2}
        pool.release_all()


@pytest.mark.parametrize("axis", [0, 1])
def test_intrinsics_of_a_level_find_the_same_pixel(axis):
    """A ramp's grey value is the coordinate on level 0: each level must show it where its own intrinsics project to."""
    v, u = np.mgrid[:240, :320].astype(np.float32)
    pool = PyramidPool(CAMERA, 1)
    slot = pool.build((u, v)[axis])
    point = np.array([0.13, -0.17])  # x/z, y/z
    fx, fy, cx, cy = CAMERA.parameters
    wanted = (fx * point[0] + cx, fy * point[1] + cy)[axis]
    for level, (width, _) in enumerate(pool.shape.sizes):
        fx, fy, cx, cy = level_intrinsics(CAMERA.parameters, level)
        x, y = np.float32(fx * point[0] + cx), np.float32(fy * point[1] + cy)
        assert sample(pool.level(slot, level), width, x, y) == pytest.approx(wanted, abs=1e-3)
