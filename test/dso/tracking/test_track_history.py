# SPDX-License-Identifier: BSD-3-Clause
"""What the last frames tell of the next one, also when their keyframes have been refined since."""

import numpy as np
import pytest
from synthetic import CAMERA

from ceiling_dso_ros.dso import CameraMotion
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.images.frame import Frame
from ceiling_dso_ros.dso.tracking.frame_tracker import TrackedFrame
from ceiling_dso_ros.dso.tracking.track_history import TrackHistory
from ceiling_dso_ros.dso.tracking.tracking_reference import ReferenceLevel, TrackingReference

FRAME_NS = 33_333_333
STEP = se3.exp(np.array([0.02, -0.01, 0.0, 0.0, 0.0, 0.03]))


def reference(keyframe_id, T_camera_world):
    return TrackingReference(keyframe_id, T_camera_world, np.zeros(2), 1.0, CAMERA.parameters, ())


def frame(T_camera_world, affine=(0.0, 0.0), stamp_ns=0):
    return Frame(stamp_ns, 1.0, 0, T_camera_world, np.array(affine))


def poses(known):
    return lambda keyframe_id: se3.inverse(known[keyframe_id].T_camera_world)


def test_before_the_first_frame_nothing_is_expected_of_its_error():
    assert TrackHistory().rmse == np.inf


def test_the_motion_goes_on_as_it_did():
    history, keyframe = TrackHistory(), reference(3, np.eye(4))
    history.begin(3)
    history.remember(frame(STEP, affine=(0.1, 2.0)), keyframe, rmse=4.0)
    likeliest = next(iter(history.hypotheses(keyframe, poses({3: keyframe}), 2 * FRAME_NS, None)))
    np.testing.assert_allclose(likeliest, STEP @ STEP, atol=1e-12)
    assert history.rmse == 4.0
    np.testing.assert_array_equal(history.affine, [0.1, 2.0])


def test_only_the_last_two_frames_count():
    history, keyframe = TrackHistory(), reference(0, np.eye(4))
    history.begin(0)
    for k, T in enumerate((se3.exp(np.full(6, 0.2)), STEP, STEP @ STEP)):
        history.remember(frame(T, stamp_ns=(k - 1) * FRAME_NS), keyframe, 1.0)
    likeliest = next(iter(history.hypotheses(keyframe, poses({0: keyframe}), 2 * FRAME_NS, None)))
    np.testing.assert_allclose(likeliest, STEP @ STEP @ STEP, atol=1e-12)


def test_a_wrong_last_pose_does_not_mislead_all():
    """A torn image between two frames of a steady motion: what it would be without it is tried, too."""
    history, keyframe, torn = TrackHistory(), reference(0, np.eye(4)), se3.exp(np.full(6, 0.2))
    history.begin(0)
    for k, T in enumerate((STEP, STEP @ STEP, torn)):
        history.remember(frame(T, stamp_ns=k * FRAME_NS), keyframe, 1.0)
    tried = list(history.hypotheses(keyframe, poses({0: keyframe}), 3 * FRAME_NS, None))
    expected = STEP @ STEP @ STEP @ STEP
    assert min(np.abs(T - expected).max() for T in tried) < 1e-12
    np.testing.assert_allclose(tried[0], torn @ se3.inverse(STEP @ STEP) @ torn, atol=1e-12)  # likeliest, as ever


def test_one_bad_frame_does_not_make_bad_ones_usual():
    history, keyframe = TrackHistory(), reference(0, np.eye(4))
    history.begin(0)
    usual = []
    for k, rmse in enumerate((4.0, 9.0, 8.0, 9.0)):
        history.remember(frame(STEP, stamp_ns=k * FRAME_NS), keyframe, rmse)
        usual.append(history.rmse)
    assert usual == [4.0, 4.0, 8.0, 9.0]


def test_a_refined_keyframe_takes_its_frames_along():
    history, keyframe = TrackHistory(), reference(0, np.eye(4))
    history.begin(0)
    T_keyframe_camera = history.remember(frame(STEP), keyframe, 1.0)
    np.testing.assert_allclose(T_keyframe_camera, se3.inverse(STEP), atol=1e-12)
    moved = reference(0, se3.exp(np.array([0.0, 0.3, 0.0, 0.0, 0.1, 0.0])))
    likeliest = next(iter(history.hypotheses(moved, poses({0: moved}), 2 * FRAME_NS, None)))
    np.testing.assert_allclose(likeliest, STEP @ STEP, atol=1e-12)


@pytest.mark.parametrize("known_motion", [np.eye(4), se3.exp(np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.2]))])
def test_a_known_motion_comes_first(known_motion):
    history, keyframe = TrackHistory(), reference(0, np.eye(4))
    history.begin(0)
    history.remember(frame(STEP), keyframe, 1.0)
    prediction = CameraMotion(known_motion, 1e-6 * np.eye(6))
    likeliest = next(iter(history.hypotheses(keyframe, poses({0: keyframe}), 2 * FRAME_NS, prediction)))
    np.testing.assert_allclose(likeliest, se3.inverse(known_motion) @ STEP, atol=1e-12)


@pytest.mark.parametrize(
    ("gaps_ns", "expected"),
    [
        ((FRAME_NS, FRAME_NS), 1.0),
        ((FRAME_NS, FRAME_NS + 2_000_000), 1.0),  # jitter of the stamps
        ((FRAME_NS, 2 * FRAME_NS), 2.0),  # an image was dropped
        ((2 * FRAME_NS, FRAME_NS), 0.5),
        ((FRAME_NS, 90 * FRAME_NS), 5.0),  # a pause, after which nobody knows
    ],
)
def test_the_motion_goes_on_for_the_time_that_has_passed(gaps_ns, expected):
    history, keyframe = TrackHistory(), reference(0, np.eye(4))
    begin_ns, (before_ns, since_ns) = 1_732_800_000_123_456_789, gaps_ns
    history.begin(0)
    history.remember(frame(np.eye(4), stamp_ns=begin_ns), keyframe, 1.0)
    history.remember(frame(STEP, stamp_ns=begin_ns + before_ns), keyframe, 1.0)
    next_ns = begin_ns + before_ns + since_ns
    likeliest = next(iter(history.hypotheses(keyframe, poses({0: keyframe}), next_ns, None)))
    if expected == 1.0:
        np.testing.assert_array_equal(likeliest, STEP @ STEP)
    np.testing.assert_allclose(likeliest, se3.exp(expected * se3.log(STEP)) @ STEP, atol=1e-9)


def straight(history, keyframe, frames=3):
    """Frames that go on by STEP each; returns the pose of the next one."""
    history.begin(0)
    T = np.eye(4)
    for k in range(frames):
        T = STEP @ T
        history.remember(frame(T, stamp_ns=k * FRAME_NS), keyframe, 1.0)
    return STEP @ T


def textured(keyframe_id):
    """A reference with points all over the image, at unit depth."""
    u, v = (values.ravel().astype(np.float32) for values in np.mgrid[10:310:5, 10:230:5])
    level = ReferenceLevel(u, v, np.ones_like(u), np.zeros_like(u))
    return TrackingReference(keyframe_id, np.eye(4), np.zeros(2), 1.0, CAMERA.parameters, (level,))


def doubts(history, keyframe, T_frame_world, stamp_ns, prediction=None):
    tracked = TrackedFrame(T_frame_world, np.zeros(2), 1.0, 0.0, 0.0, 0.0, np.eye(6), 10.0, np.zeros(6))
    return history.doubts(tracked, keyframe, poses({0: keyframe}), stamp_ns, prediction)


BACK = np.linalg.inv(STEP)


def test_a_frame_that_goes_on_stops_or_turns_back_is_believed():
    history, keyframe = TrackHistory(), textured(0)
    T_next = straight(history, keyframe)
    for T in (T_next, BACK @ T_next, BACK @ BACK @ T_next, STEP @ T_next):
        assert not doubts(history, keyframe, T, 3 * FRAME_NS)


def test_a_frame_of_another_time_is_doubted_until_the_next_one_confirms_it():
    history, keyframe = TrackHistory(), textured(0)
    T_next = straight(history, keyframe)
    T_old = np.linalg.matrix_power(BACK, 25) @ T_next
    assert doubts(history, keyframe, T_old, 3 * FRAME_NS)
    assert not doubts(history, keyframe, STEP @ T_next, 4 * FRAME_NS)  # it was one bad image
    assert doubts(history, keyframe, T_old, 5 * FRAME_NS)
    far = np.linalg.matrix_power(STEP, 60)
    assert doubts(history, keyframe, far @ T_old, 6 * FRAME_NS)  # two bad ones do not confirm each other
    assert not doubts(history, keyframe, STEP @ far @ T_old, 7 * FRAME_NS)  # the camera is somewhere else now


def test_wheels_that_predict_a_motion_confirm_it():
    history, keyframe = TrackHistory(), textured(0)
    T_next = straight(history, keyframe)
    T_stop = np.linalg.matrix_power(BACK, 8) @ T_next
    T_last_frame = BACK @ T_next @ np.linalg.inv(T_stop)
    assert not doubts(history, keyframe, T_stop, 3 * FRAME_NS, CameraMotion(T_last_frame, np.zeros((6, 6))))


def test_after_a_long_time_a_camera_may_be_anywhere():
    history, keyframe = TrackHistory(), textured(0)
    T_next = straight(history, keyframe)
    assert not doubts(history, keyframe, np.linalg.matrix_power(BACK, 8) @ T_next, 12 * FRAME_NS)


def test_patience_counts_from_the_last_pose():
    history, keyframe = TrackHistory(), textured(0)
    straight(history, keyframe)
    assert history.miss(100 * FRAME_NS, patience_s=1.0)  # one bad image is no reason to give up
    assert not history.miss(101 * FRAME_NS, patience_s=1.0)
    straight(history, keyframe)
    assert all(history.miss((2 + k) * FRAME_NS, patience_s=1.0) for k in range(1, 31))
    assert not history.miss(33 * FRAME_NS, patience_s=1.0)


def test_a_wrong_last_pose_is_overruled_by_two_frames_that_agree_with_the_wheels():
    """As after a torn image at few images a second: the wheels say how the camera moved, from a pose that is wrong."""
    history, keyframe = TrackHistory(), textured(0)
    T_next = straight(history, keyframe)
    wrong = np.linalg.matrix_power(BACK, 25) @ T_next
    history.remember(frame(wrong, stamp_ns=3 * FRAME_NS), keyframe, 1.0)
    history.remember(frame(wrong, stamp_ns=4 * FRAME_NS), keyframe, 1.0)
    turn = se3.exp(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.3]))  # not what the frames before tell
    by_wheels = [CameraMotion(se3.inverse(np.linalg.matrix_power(turn, k)), 1e-6 * np.eye(6)) for k in (1, 2)]
    assert doubts(history, keyframe, turn @ T_next, 5 * FRAME_NS, by_wheels[0])
    assert not doubts(history, keyframe, turn @ turn @ T_next, 6 * FRAME_NS, by_wheels[1])
