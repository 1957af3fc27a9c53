# SPDX-License-Identifier: BSD-3-Clause
"""The keyframes of the window: evaluation points, steps, and what leaves with a keyframe."""

import numpy as np
import pytest
from synthetic import AFFINES, POSES, true_window

from ceiling_dso_ros.dso.adjustment.bundle_adjustment import marginalize_keyframe
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.images.selection import SelectedPixels

RNG = np.random.default_rng(0)


@pytest.fixture
def window():
    window = true_window(10)
    for host in range(3):
        u = np.full(5 + host, 100.0 + host, np.float32)
        window.candidates.add(SelectedPixels(u, u, np.ones_like(u)), host, window.image(host), window.width)
    return window


def test_a_new_keyframe_is_its_own_evaluation_point(window):
    assert window.count == 3
    assert window.newest == 2
    assert window.offsets.shape == (28,)
    assert not window.offsets.any()
    for slot in range(3):
        np.testing.assert_allclose(window.keyframes.T_camera_world_eval[slot], POSES[slot], atol=1e-12)
        np.testing.assert_allclose(window.T_world_camera(slot), np.linalg.inv(POSES[slot]), atol=1e-12)
        assert window.keyframes.affine[slot].tolist() == list(AFFINES[slot])


def test_the_prior_grows_with_the_window_and_knows_nothing_of_a_new_keyframe():
    window = true_window(5, poses=POSES[:2])
    window.prior.H[:], window.prior.b[:] = 3.0, 4.0
    slot = window.pool.build(np.zeros((240, 320), np.float32))
    window.add_keyframe(9, 10**9, slot, POSES[2], np.zeros(2), 1.0)
    assert window.prior.H.shape == (28, 28)
    assert (window.prior.H[:20, :20] == 3).all()
    assert (window.prior.b[:20] == 4).all()
    assert not window.prior.H[20:].any()
    assert not window.prior.H[:, 20:].any()
    assert not window.prior.b[20:].any()


def test_steps_add_up_to_a_left_increment_on_the_evaluation_point(window):
    steps = 0.01 * RNG.normal(size=(2, 28))
    window.move(steps[0])
    window.move(steps[1])
    total = steps.sum(axis=0)
    np.testing.assert_allclose(window.offsets, total, atol=1e-15)
    np.testing.assert_allclose(window.intrinsics - window.intrinsics_eval, total[:4], atol=1e-12)
    for slot in range(3):
        part = total[4 + 8 * slot : 12 + 8 * slot]
        np.testing.assert_allclose(window.keyframes.T_camera_world[slot], se3.exp(part[:6]) @ POSES[slot], atol=1e-12)
        np.testing.assert_allclose(window.keyframes.affine[slot], np.array(AFFINES[slot]) + part[6:], atol=1e-12)


def test_relinearize_keeps_the_estimate(window):
    window.move(0.01 * RNG.normal(size=28))
    T = window.keyframes.T_camera_world[1].copy()
    window.relinearize(1)
    assert not window.keyframes.offset[1].any()
    assert window.keyframes.offset[0].any()
    window.move(np.zeros(28))
    np.testing.assert_allclose(window.keyframes.T_camera_world[1], T, atol=1e-12)


def test_a_removed_keyframe_leaves_nothing_behind(window):
    image2, T2 = window.image(2).copy(), window.keyframes.T_camera_world[2].copy()
    exposure2 = window.keyframes.exposure[2]
    points = window.points.arrays.idepth[20:30].copy()
    window.remove_keyframe(1)
    assert window.ids == [0, 2]
    assert window.stamps_ns == [0, 200_000_000]
    assert len(window.gone_points) == window.count == 2
    np.testing.assert_array_equal(window.image(1), image2)
    np.testing.assert_array_equal(window.keyframes.T_camera_world[1], T2)
    assert window.keyframes.exposure[1] == exposure2
    assert window.points.host_ranges(2).tolist() == [0, 10, 20]
    np.testing.assert_array_equal(window.points.arrays.idepth[10:20], points)
    assert window.candidates.host_ranges(2).tolist() == [0, 5, 12]


def test_images_of_removed_keyframes_are_free_again(window):
    for _ in range(20):
        marginalize_keyframe(window, 0, np.zeros(2))
        slot = window.pool.build(np.zeros((240, 320), np.float32))
        window.add_keyframe(7, 10**9, slot, np.eye(4), np.zeros(2), 1.0)
    assert len(set(window.keyframes.image_slot[:3].tolist())) == 3


def test_estimates_say_where_keyframes_are_and_which_leave(window):
    estimates = window.estimates(segment=5, leaving=(1,))
    assert [e.keyframe_id for e in estimates] == [0, 1, 2]
    assert [e.leaves for e in estimates] == [False, True, False]
    assert {e.segment for e in estimates} == {5}
    for slot, estimate in enumerate(estimates):
        np.testing.assert_allclose(estimate.T_world_camera, np.linalg.inv(POSES[slot]), atol=1e-12)
        assert estimate.affine == pytest.approx(AFFINES[slot])
