# SPDX-License-Identifier: BSD-3-Clause
"""Through the messages of the nodes, as they go over a wire, stamps are the very same integers."""

import numpy as np
import pytest

pytest.importorskip("ceiling_dso_ros.msg", reason="needs ROS and the built workspace")
pytestmark = pytest.mark.ros

from hypothesis import given, settings  # noqa: E402
from hypothesis import strategies as st  # noqa: E402
from std_msgs.msg import Header  # noqa: E402
from straight_drive import Drive, sent  # noqa: E402

from ceiling_dso_ros.dso import KeyframeEstimate, OdometryStatus, TrackingState  # noqa: E402
from ceiling_dso_ros.fusion.config import RobotModel  # noqa: E402
from ceiling_dso_ros.fusion.estimator import FusionEstimator  # noqa: E402
from ceiling_dso_ros.ros.conversions import ros_time, status_message  # noqa: E402
from ceiling_dso_ros.ros.data_clock import DataClock  # noqa: E402
from ceiling_dso_ros.ros.fusion_publisher import prediction_message  # noqa: E402
from ceiling_dso_ros.ros.motion_predictions import MotionPredictions  # noqa: E402
from ceiling_dso_ros.ros.visual_input import VisualInput  # noqa: E402

LATEST_ROS_NS = 2**32 * 10**9 - 1  # ROS keeps seconds in 32 bits
ros_stamps = st.integers(0, LATEST_ROS_NS)


@settings(deadline=None, database=None)
@given(ros_stamps)
def test_ros_times_and_back(stamp_ns):
    assert ros_time(stamp_ns).to_nsec() == stamp_ns


@pytest.mark.parametrize(("stamp_ns", "nearest_ns"), [(-1, 0), (LATEST_ROS_NS + 3 * 10**9, LATEST_ROS_NS)])
def test_stamps_that_ros_has_no_time_for_can_be_sent(stamp_ns, nearest_ns):
    """As of a message whose nanoseconds are more than a second at the end of time: its output could not be sent."""
    assert sent(Header(stamp=ros_time(stamp_ns))).stamp.to_nsec() == nearest_ns


@settings(deadline=None, database=None)
@given(ros_stamps, ros_stamps)
def test_a_status_and_its_keyframes(image_ns, keyframe_ns):
    T = np.eye(4)
    keyframe = KeyframeEstimate(3, keyframe_ns, 0, T, (0.0, 0.0), False)
    status = OdometryStatus(
        image_ns, TrackingState.TRACKING, 0, T, keyframe_id=3, T_keyframe_camera=T, keyframes=(keyframe,)
    )
    message = status_message(Header(stamp=ros_time(image_ns), frame_id="vo"), status)
    got = VisualInput(DataClock()).status(sent(message))
    assert (got.stamp_ns, got.keyframes[0].stamp_ns) == (image_ns, keyframe_ns)


def test_300_of_300_predictions_are_used_at_todays_epoch():
    drive, predictions, visual = Drive(), MotionPredictions(), VisualInput(DataClock())
    estimator = FusionEstimator(RobotModel(np.eye(4), 0.5, (0.1, 0.1)))
    wheels = drive.wheels(drive.image_ns(400))
    wheel_ns, pose = next(wheels)
    newest = None
    for k in range(400):
        while wheel_ns <= drive.image_ns(k):  # what fusion_node does with a sample
            estimator.add_wheel_odometry(wheel_ns, pose)
            motion = None if newest is None else estimator.predict_camera_motion(newest, wheel_ns)
            if motion is not None:
                header = Header(stamp=ros_time(wheel_ns), frame_id="vo")
                predictions.add(sent(prediction_message(header, newest.stamp_ns, motion, newest.segment)))
            wheel_ns, pose = next(wheels)
        message = drive.image(k)
        if k >= 100:  # dso_node with an image, long after the first keyframe
            motion = predictions.between(drive.image_ns(k - 1), message.header.stamp.to_nsec(), 0)
            expected = drive.SPEED_M_S / 30 / drive.HEIGHT_M
            np.testing.assert_allclose(motion.T_start_end[:3, 3], [expected, 0.0, 0.0], atol=1e-3)
        newest = visual.status(message)
        estimator.add_keyframes(newest)
        estimator.add_frame(newest)
    assert (predictions.used, predictions.asked) == (300, 300)
