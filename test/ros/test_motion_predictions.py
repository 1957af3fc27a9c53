# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

pytest.importorskip("ceiling_dso_ros.msg", reason="needs ROS and the built workspace")
pytestmark = pytest.mark.ros

from std_msgs.msg import Header  # noqa: E402

from ceiling_dso_ros.dso import CameraMotion  # noqa: E402
from ceiling_dso_ros.dso.durations import nanoseconds  # noqa: E402
from ceiling_dso_ros.dso.geometry import se3  # noqa: E402
from ceiling_dso_ros.msg import MotionPrediction  # noqa: E402
from ceiling_dso_ros.ros.conversions import pose_from_matrix, ros_time  # noqa: E402
from ceiling_dso_ros.ros.fusion_publisher import prediction_message  # noqa: E402
from ceiling_dso_ros.ros.motion_predictions import MotionPredictions, stretched  # noqa: E402

START_NS = 1_732_800_000_123_456_789
TWIST = np.array([0.5, -0.1, 0.05, 0.01, 0.02, 0.3])  # a second
COVARIANCE = np.diag([4e-4, 1e-4, 1e-6, 1e-6, 1e-6, 4e-4]).ravel().tolist()


def prediction(seconds=0.02):
    motion = pose_from_matrix(se3.exp(seconds * TWIST))
    return MotionPrediction(
        header=Header(stamp=ros_time(START_NS + nanoseconds(seconds))),
        start=ros_time(START_NS),
        motion=motion,
        covariance=COVARIANCE,
    )


@pytest.mark.parametrize("seconds", [0.01, 0.02, 0.05])
def test_velocity_stays_the_same(seconds):
    motion = stretched(prediction(), START_NS + nanoseconds(seconds))
    np.testing.assert_allclose(motion.T_start_end, se3.exp(seconds * TWIST), atol=1e-8)
    sigma = np.sqrt(np.diag(motion.covariance))
    np.testing.assert_allclose(sigma, seconds / 0.02 * np.array([0.02, 0.01, 1e-3, 1e-3, 1e-3, 0.02]), rtol=1e-6)


def test_far_ends_are_not_predicted():
    assert stretched(prediction(), START_NS + 500_000_000) is None
    assert stretched(prediction(), START_NS - 100_000_000) is None
    assert stretched(prediction(seconds=0.0), START_NS + 10_000_000) is None


def test_garbage_is_not_used():
    message = prediction()
    message.motion.position.x = float("nan")
    assert stretched(message, START_NS + 20_000_000) is None
    message = prediction()
    for wrong in (float("nan"), 1e300):
        message.covariance = [*COVARIANCE[:3], wrong, *COVARIANCE[4:]]
        assert stretched(message, START_NS + 20_000_000) is None


def test_the_plane_of_the_motion_comes_out_as_it_went_in():
    """What dso_node and `run` are told is the same."""
    normal = np.array([0.02, -0.03, 1.0]) / np.linalg.norm([0.02, -0.03, 1.0])
    for sent in (CameraMotion(np.eye(4), np.eye(6), metric=True, normal=normal), CameraMotion(np.eye(4), np.eye(6))):
        message = prediction_message(Header(stamp=ros_time(START_NS + 20_000_000)), START_NS, sent, 3)
        got = stretched(message, START_NS + 20_000_000)
        assert got.metric == sent.metric
        if sent.normal is None:
            assert got.normal is None
        else:
            np.testing.assert_allclose(got.normal, normal, atol=1e-15)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_plane_that_is_none_is_not_used(value):
    message = prediction()
    message.normal = [0.0, 0.0, value]
    assert stretched(message, START_NS + 20_000_000).normal is None


def path(seconds):
    """T from the first image to a time, of a camera that turns ever faster."""
    return se3.exp(seconds * TWIST) @ se3.exp(seconds**2 * np.array([0.0, 0.2, 0.0, 0.0, 0.0, 0.8]))


def told(start_s, ends_s, segment=0):
    for end_s in ends_s:
        yield MotionPrediction(
            header=Header(stamp=ros_time(START_NS + nanoseconds(end_s))),
            start=ros_time(START_NS + nanoseconds(start_s)),
            motion=pose_from_matrix(se3.inverse(path(start_s)) @ path(end_s)),
            covariance=COVARIANCE,
            segment=segment,
        )


def test_images_that_come_all_at_once_are_predicted_by_the_wheels_since_an_earlier_one():
    predictions = MotionPredictions()
    for message in told(0.0, np.arange(0.02, 1.0, 0.02)):
        predictions.add(message)
    stamps_s = np.arange(1, 14) / 15.0
    for start_s, end_s in zip(stamps_s, stamps_s[1:]):
        motion = predictions.between(START_NS + nanoseconds(start_s), START_NS + nanoseconds(end_s), 0)
        np.testing.assert_allclose(motion.T_start_end, se3.inverse(path(start_s)) @ path(end_s), atol=2e-3)
    assert predictions.used == predictions.asked == len(stamps_s) - 1


def test_the_message_that_ends_there_is_used():
    predictions = MotionPredictions()
    for message in told(0.0, (0.02, 0.08, 0.5)):
        predictions.add(message)
    motion = predictions.between(START_NS, START_NS + nanoseconds(0.08), 0)
    np.testing.assert_allclose(motion.T_start_end, path(0.08), atol=1e-8)


def test_another_segment_predicts_nothing():
    predictions = MotionPredictions()
    for message in told(0.0, (0.05, 0.1), segment=1):
        predictions.add(message)
    assert predictions.between(START_NS + nanoseconds(0.05), START_NS + nanoseconds(0.1), 0) is None
    assert predictions.between(START_NS - nanoseconds(0.05), START_NS + nanoseconds(0.1), 1) is None
