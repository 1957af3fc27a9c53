# SPDX-License-Identifier: BSD-3-Clause
"""The sparse depth of a keyframe: right values at the right pixels of every level."""

import numpy as np
import pytest
from synthetic import AFFINES, EXPOSURES, POSES, Surface, linearized, true_window

from ceiling_dso_ros.dso.geometry.projection import level_intrinsics
from ceiling_dso_ros.dso.tracking.tracking_reference import ReferenceBuilder, collect, splat, sum_down
from ceiling_dso_ros.dso.window.points import OUTLIER

SURFACE = Surface(slope=(-0.2, 0.1), relief=0.05)


@pytest.fixture
def window():
    window = true_window(150, surface=SURFACE)
    linearized(window)
    return window


def test_depth_and_grey_values_of_all_levels(window):
    reference = ReferenceBuilder(window.pool.shape).build(window)
    assert len(reference.levels) == 3
    for index, (level, (width, height)) in enumerate(zip(reference.levels, window.pool.shape.sizes)):
        assert level.u.size > 100
        assert (level.u == np.round(level.u)).all()
        assert level.u.max() < width - 2
        assert level.v.min() >= 2
        image = window.pool.level(int(window.keyframes.image_slot[2]), index).reshape(height, width)
        np.testing.assert_array_equal(level.grey, image[level.v.astype(int), level.u.astype(int)])
        parameters = level_intrinsics(window.intrinsics, index)
        true = SURFACE.look(POSES[2], parameters, level.u.astype(float), level.v.astype(float))[1]
        assert np.median(np.abs(level.idepth / true - 1)) < 0.006  # rounded to pixels and dilated
        assert np.abs(level.idepth / true - 1).max() < 0.05
        assert level.idepth.dtype == level.grey.dtype == np.float32


def test_it_describes_the_newest_keyframe(window):
    reference = ReferenceBuilder(window.pool.shape).build(window)
    assert reference.keyframe_id == 2
    np.testing.assert_allclose(reference.T_camera_world, POSES[2], atol=1e-12)
    assert reference.affine.tolist() == list(AFFINES[2])
    assert reference.exposure == EXPOSURES[2]
    np.testing.assert_array_equal(reference.intrinsics, window.intrinsics)
    window.move(np.full(28, 0.01))
    np.testing.assert_allclose(reference.T_camera_world, POSES[2], atol=1e-12)  # it stays when the window goes on


def test_only_inliers_of_the_newest_keyframe_count(window):
    window.points.residuals.state[2, :150] = OUTLIER
    window.points.residuals.live[2, 150:290] = 0
    reference = ReferenceBuilder(window.pool.shape).build(window)
    points = window.points.residuals
    visible = ((points.state[2, :450] == 1) & (points.live[2, :450] > 0)).sum()
    assert visible <= 10
    assert 0 < reference.levels[0].u.size <= 5 * visible


def test_a_builder_forgets_the_last_reference(window):
    builder = ReferenceBuilder(window.pool.shape)
    first = builder.build(window)
    again = builder.build(window)
    for a, b in zip(first.levels, again.levels):
        for name in ("u", "v", "idepth", "grey"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def test_points_that_meet_are_averaged_by_weight():
    total, weight = np.zeros(200, np.float32), np.zeros(200, np.float32)
    x, y, idepth, w = (
        np.array(a, np.float32) for a in ([5.4, 4.6, 9.0, 0.0], [3.0, 3.4, 5.0, 3.0], [1, 2, 3, 4], [1, 3, 2, 1])
    )
    pixels = np.zeros(4, np.int64)
    assert splat(x, y, idepth, w, 20, 10, total, weight, pixels) == 2
    assert pixels[:2].tolist() == [3 * 20 + 5, 5 * 20 + 9]
    assert total[3 * 20 + 5] == 7
    assert weight[3 * 20 + 5] == 4
    assert total[5 * 20 + 9] == 6
    assert weight.sum() == 6  # the last one lies in the border


def test_coarser_levels_are_sums():
    fine, fine_weight = np.arange(48, dtype=np.float32), np.ones(48, np.float32)
    coarse, weight, listed = np.zeros(12, np.float32), np.zeros(12, np.float32), np.zeros(12, np.int64)
    pixels = np.flatnonzero(np.arange(48) % 8 < 6)  # the last column of coarse pixels stays empty
    count = sum_down(pixels, fine, fine_weight, 8, 4, 3, coarse, weight, listed)
    sums = fine.reshape(3, 2, 4, 2).sum(axis=(1, 3))
    np.testing.assert_array_equal(coarse.reshape(3, 4)[:, :3], sums[:, :3])
    assert not coarse.reshape(3, 4)[:, 3].any()
    assert sorted(listed[:count]) == np.flatnonzero(weight).tolist() == [0, 1, 2, 4, 5, 6, 8, 9, 10]


@pytest.mark.parametrize(
    ("diagonal", "neighbours"), [(True, {(4, 4), (6, 4), (4, 6), (6, 6)}), (False, {(4, 5), (6, 5), (5, 4), (5, 6)})]
)
def test_dilation(diagonal, neighbours):
    width, height = 12, 11
    total, weight = np.zeros(width * height, np.float32), np.zeros(width * height, np.float32)
    total[5 * width + 5], weight[5 * width + 5] = 6.0, 3.0
    image = np.arange(width * height, dtype=np.float32)
    u, v, idepth, grey = (np.zeros(width * height, np.float32) for _ in range(4))
    seen = np.zeros(width * height, np.uint8)
    pixels = np.array([5 * width + 5])
    count = collect(pixels, total, weight, image, width, height, diagonal, seen, u, v, idepth, grey)
    assert not seen.any()
    assert set(zip(u[:count].tolist(), v[:count].tolist())) == neighbours | {(5, 5)}
    assert (idepth[:count] == 2.0).all()
    np.testing.assert_array_equal(grey[:count], v[:count] * width + u[:count])
