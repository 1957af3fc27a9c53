# SPDX-License-Identifier: BSD-3-Clause
"""When keyframes come and go, and what becomes of their points."""

import numpy as np
import pytest
from synthetic import CAMERA, SLANTED, add_keyframe, add_points, empty_window, random_pixels, true_window

from ceiling_dso_ros.dso.config import KeyframeConfig, OptimizationConfig, WindowConfig
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.dso.mapping.keyframe_policy import (
    KeyframeTrigger,
    PointFate,
    brightness_change,
    keyframes_to_marginalize,
)
from ceiling_dso_ros.dso.tracking.frame_tracker import TrackedFrame
from ceiling_dso_ros.dso.tracking.tracking_reference import TrackingReference
from ceiling_dso_ros.dso.window.points import INLIER, NONE, OUT_OF_BOUNDS, OUTLIER

WIDTH_AND_HEIGHT = CAMERA.width + CAMERA.height
REFERENCE = TrackingReference(0, np.eye(4), np.array([0.1, 0.0]), 2.0, CAMERA.parameters, ())


def tracked(rmse=2.0, translation_flow=0.0, motion_flow=0.0, a=0.1):
    return TrackedFrame(
        np.eye(4), np.array([a, 0.0]), rmse, 0.0, translation_flow, motion_flow, np.eye(6), 100.0, np.zeros(6)
    )


def needs(frame, exposure=2.0, first_rmse=2.0):
    trigger = KeyframeTrigger(CAMERA, KeyframeConfig())
    trigger.fires(tracked(rmse=first_rmse), 2.0, REFERENCE)
    return trigger.fires(frame, exposure, REFERENCE)


def test_a_frame_like_the_keyframe_is_none():
    assert not needs(tracked())


@pytest.mark.parametrize(
    "change",
    [
        {"translation_flow": 0.1 * WIDTH_AND_HEIGHT**2, "motion_flow": 0.1 * WIDTH_AND_HEIGHT**2},
        {"motion_flow": 0.1 * WIDTH_AND_HEIGHT**2},
        {"a": 1.3},
        {"a": -1.1},
        {"rmse": 20.0, "motion_flow": 1.0},
    ],
)
def test_flow_brightness_and_error_each_ask_for_a_keyframe(change):
    assert needs(tracked(**change)) is True


def test_a_growing_error_is_no_reason_while_the_camera_stands_still():
    assert needs(tracked(rmse=20.0)) is False


def test_exposure_counts_as_brightness_and_may_cancel_it():
    assert brightness_change(np.array([0.1, 5.0]), 2.0, REFERENCE) == pytest.approx(0.0)
    assert brightness_change(np.array([0.1, 5.0]), 4.0, REFERENCE) == pytest.approx(np.log(2))
    assert brightness_change(np.array([0.1 - np.log(2), 5.0]), 4.0, REFERENCE) == pytest.approx(0.0)
    assert needs(tracked(), exposure=8.0)
    assert not needs(tracked(a=0.1 - np.log(4.0)), exposure=8.0)


def test_flow_is_relative_to_the_size_of_the_image():
    """A shift that makes a keyframe on a small image is nothing on a large one."""
    frame = tracked(translation_flow=100.0, motion_flow=100.0)
    cameras = [PinholeCamera(100.0, 100.0, side / 2, side / 2, side, side) for side in (100, 10000)]
    fired = [KeyframeTrigger(camera, KeyframeConfig()).fires(frame, 2.0, REFERENCE) for camera in cameras]
    assert fired == [True, False]


def test_the_error_counts_against_the_first_one_on_the_same_keyframe():
    trigger = KeyframeTrigger(CAMERA, KeyframeConfig())
    moving = {"motion_flow": 1.0}
    assert not trigger.fires(tracked(rmse=2.0, **moving), 2.0, REFERENCE)
    assert trigger.fires(tracked(rmse=20.0, **moving), 2.0, REFERENCE)
    trigger.renew()
    assert not trigger.fires(tracked(rmse=20.0, **moving), 2.0, REFERENCE)


# What leaves


def row_of_keyframes(positions, points=20, affines=None):
    window = empty_window(max_keyframes=max(4, len(positions) + 1))
    for k, x in enumerate(positions):
        affine = (affines[k], 0.0) if affines else (0.0, 0.0)
        add_keyframe(window, se3.exp(np.array([-x, 0, 0, 0, 0, 0.0])), affine=affine)
    for host in range(len(positions)):
        u, v = random_pixels(np.random.default_rng(host), points)
        add_points(window, host, u, v, SLANTED.idepth(window.keyframes.T_camera_world[host], u, v))
    return window


def leaving(window, max_keyframes, min_keyframes=2, position=(1.0, 0, 0)):
    config = WindowConfig(max_keyframes=max_keyframes, min_keyframes=min_keyframes)
    return keyframes_to_marginalize(window, np.array(position), config)


def test_nobody_leaves_a_window_with_room():
    assert leaving(row_of_keyframes([0, 0.1, 0.2, 0.3]), max_keyframes=6) == []


def test_one_leaves_a_full_window_and_never_the_newest():
    slots = leaving(row_of_keyframes([0, 0.1, 0.2, 0.3]), max_keyframes=4)
    assert len(slots) == 1
    assert slots[0] < 3


def test_the_crowded_one_leaves():
    """Two keyframes next to each other and far from the newest: one of them goes."""
    slots = leaving(row_of_keyframes([0, 0.4, 0.41, 0.9]), max_keyframes=4)
    assert slots in ([1], [2])


def test_an_empty_keyframe_leaves():
    window = row_of_keyframes([0, 0.1, 0.2, 0.3])
    window.points.keep(window.points.arrays.host[: window.points.count] != 1)
    window.gone_points[1] = 20
    assert leaving(window, max_keyframes=6) == [1]
    assert leaving(window, max_keyframes=6, min_keyframes=5) == []  # rather one too empty than too few


def test_a_keyframe_of_another_brightness_stays():
    """Lamps that go out would empty the window at once, and with it what tells the unit of length."""
    assert leaving(row_of_keyframes([0, 0.1, 0.2, 0.3], affines=[0.0, 1.5, 0.0, 0.0]), max_keyframes=6) == []


def test_a_keyframe_that_lost_no_points_stays():
    window = row_of_keyframes([0, 0.1, 0.2, 0.3])
    window.points.keep(window.points.arrays.host[: window.points.count] != 1)
    assert leaving(window, max_keyframes=6) == []


# Points


@pytest.fixture
def window():
    """Every point is an inlier everywhere, informative and old enough."""
    window = true_window(10)
    window.points.arrays.idepth_hessian[:30] = 1e4
    window.points.arrays.good_residuals[:30] = 10
    return window


OPTIMIZATION = OptimizationConfig(point_min_live_residuals=2)


def fate(window, leaving=()):
    result = PointFate(window, list(leaving), OPTIMIZATION)
    assert not (result.marginalize & result.drop).any()
    return result


def test_visible_points_stay(window):
    result = fate(window)
    assert not result.marginalize.any()
    assert not result.drop.any()


def test_points_of_a_leaving_keyframe_go_into_the_prior(window):
    result = fate(window, [0])
    assert result.marginalize.tolist() == [True] * 10 + [False] * 20
    assert not result.drop.any()


@pytest.mark.parametrize(
    ("newest", "previous", "goes"), [(OUT_OF_BOUNDS, INLIER, True), (OUTLIER, OUTLIER, True), (OUTLIER, INLIER, False)]
)
def test_points_out_of_view_go(window, newest, previous, goes):
    window.points.residuals.state[2, 3], window.points.residuals.state[1, 3] = newest, previous
    result = fate(window)
    assert (result.marginalize | result.drop).tolist() == [i == 3 and goes for i in range(30)]


@pytest.mark.parametrize(("field", "value"), [("idepth_hessian", 1.0), ("good_residuals", 1), ("idepth", -0.1)])
def test_what_is_poorly_known_is_dropped_instead(window, field, value):
    getattr(window.points.arrays, field)[4] = value
    result = fate(window, [0])
    assert result.drop[4]
    assert result.drop.sum() == 1
    assert result.marginalize.sum() == 9


def test_a_point_that_few_keyframes_see_is_dropped_instead(window):
    window.points.residuals.live[2, 4] = 0
    result = fate(window, [0])
    assert result.drop.tolist() == [i == 4 for i in range(30)]
    assert result.marginalize.tolist() == [i < 10 and i != 4 for i in range(30)]


def test_a_point_without_residuals_is_dropped_wherever_it_is(window):
    window.points.residuals.live[:, 15], window.points.residuals.state[:, 15] = 0, NONE
    result = fate(window)
    assert result.drop.tolist() == [i == 15 for i in range(30)]
