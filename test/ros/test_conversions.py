# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

pytest.importorskip("ceiling_dso_ros.msg", reason="needs ROS and the built workspace")
pytestmark = pytest.mark.ros

from sensor_msgs.msg import Image  # noqa: E402
from std_msgs.msg import Header  # noqa: E402

from ceiling_dso_ros.dso import KeyframeEstimate, OdometryStatus, TrackingState  # noqa: E402
from ceiling_dso_ros.msg import VisualOdometryStatus  # noqa: E402
from ceiling_dso_ros.ros import conversions  # noqa: E402


def transform(angle, position):
    """(4, 4): a turn about z."""
    T = np.eye(4)
    T[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    T[:3, 3] = position
    return T


def test_pose_of_a_transform():
    pose = conversions.pose_from_matrix(transform(np.pi / 2, [1.0, 2.0, 3.0]))
    assert (pose.position.x, pose.position.y, pose.position.z) == (1.0, 2.0, 3.0)
    orientation = pose.orientation
    np.testing.assert_allclose(
        [orientation.x, orientation.y, orientation.z, orientation.w], [0, 0, np.sqrt(0.5), np.sqrt(0.5)], atol=1e-15
    )


def test_pose_covariance_is_that_of_sampled_increments():
    """Positions and rotations of exp(increment) T, to first order, spread as the covariance says."""
    rng = np.random.default_rng(1)
    T_world_camera = transform(0.3, [1.0, -2.0, 4.0])
    factor = rng.normal(size=(6, 6))
    increments = 1e-3 * rng.normal(size=(200_000, 6)) @ factor.T
    position = T_world_camera[:3, 3]
    moved = increments[:, :3] + np.cross(increments[:, 3:], position)
    expected = np.cov(np.hstack([moved, increments[:, 3:]]).T)
    actual = conversions.pose_covariance(1e-6 * factor @ factor.T, T_world_camera)
    np.testing.assert_allclose(actual, expected, atol=0.02 * np.abs(expected).max())


def test_covariance_is_never_singular():
    assert np.linalg.eigvalsh(conversions.pose_covariance(np.zeros((6, 6)), np.eye(4))).min() > 0.0


def test_odometry_message():
    covariance = np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    message = conversions.odometry_message(Header(frame_id="vo"), "camera", transform(0.0, [1.0, 2.0, 3.0]), covariance)
    assert (message.header.frame_id, message.child_frame_id) == ("vo", "camera")
    assert message.pose.pose.position.z == 3.0
    np.testing.assert_array_equal(np.reshape(message.pose.covariance, (6, 6)), covariance)
    assert np.diagonal(np.reshape(message.twist.covariance, (6, 6))).tolist() == [9999.0] * 6


@pytest.mark.parametrize("state", TrackingState)
def test_status_message_has_every_state(state):
    status = OdometryStatus(10**9, state, 3, message="words", active_points=5, candidate_points=7, rmse=2.5)
    message = conversions.status_message(Header(), status)
    assert message.state == getattr(VisualOdometryStatus, state.name)
    assert (message.segment, message.message, message.pose, message.keyframes) == (3, "words", [], [])
    assert (message.active_points, message.candidate_points, message.rmse) == (5, 7, 2.5)


def test_an_image_that_is_not_used_leaves_the_state_as_it_was_and_has_no_pose():
    T = transform(0.1, [1.0, 2.0, 3.0])
    tracked = OdometryStatus(10**9, TrackingState.TRACKING, 3, T, keyframe_id=4, T_keyframe_camera=T, active_points=5)
    last = conversions.status_message(Header(), tracked)
    assert [(pose.keyframe_id, pose.pose.position.x) for pose in last.pose] == [(4, 1.0)]
    message = conversions.no_pose_message(Header(), last, "torn")
    assert (message.state, message.segment, message.active_points) == (VisualOdometryStatus.TRACKING, 3, 5)
    assert (message.message, message.pose, message.keyframes) == ("torn", [], [])


def test_keyframes_keep_stamps_and_poses():
    stamp_ns = 1_700_000_001_030_042_123
    keyframe = KeyframeEstimate(4, stamp_ns, 1, transform(0.1, [1.0, 2.0, 3.0]), (0.5, -2.0), True)
    status = OdometryStatus(stamp_ns, TrackingState.TRACKING, 1, keyframes=(keyframe,))
    (message,) = conversions.status_message(Header(), status).keyframes
    assert message.stamp.to_nsec() == stamp_ns
    assert (message.id, message.segment, message.leaves) == (4, 1, True)
    assert (message.affine_a, message.affine_b, message.pose.position.x) == (0.5, -2.0, 1.0)


def test_image_message_to_grey():
    pixels = np.arange(12, dtype=np.uint8).reshape(3, 4)
    message = Image(height=3, width=4, step=4, encoding="mono8", data=pixels.tobytes())
    np.testing.assert_array_equal(conversions.image_array(message), pixels)
