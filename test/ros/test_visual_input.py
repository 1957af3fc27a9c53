# SPDX-License-Identifier: BSD-3-Clause
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("ceiling_dso_ros.msg", reason="needs ROS and the built workspace")
pytestmark = pytest.mark.ros

from geometry_msgs.msg import Pose  # noqa: E402
from std_msgs.msg import Header  # noqa: E402

from ceiling_dso_ros.dso import KeyframeEstimate, OdometryStatus, TrackingState  # noqa: E402
from ceiling_dso_ros.msg import Keyframes, RelativePose  # noqa: E402
from ceiling_dso_ros.ros.conversions import (  # noqa: E402
    no_pose_message,
    ros_time,
    status_message,
)
from ceiling_dso_ros.ros.data_clock import DataClock  # noqa: E402
from ceiling_dso_ros.ros.visual_input import VisualInput  # noqa: E402

START_NS = 1_732_800_000_123_456_789


def status(index, with_keyframes=False):
    stamp_ns = START_NS + index * 33_333_333
    T = np.eye(4)
    T[0, 3] = 0.1 * index
    keyframes = (KeyframeEstimate(index, stamp_ns, 2, T, (0.1, 0.2), False),) if with_keyframes else ()
    return OdometryStatus(
        stamp_ns, TrackingState.TRACKING, 2, T, keyframe_id=7, T_keyframe_camera=T, keyframes=keyframes, message="words"
    )


def message_of(value):
    return status_message(Header(stamp=ros_time(value.stamp_ns), frame_id="vo"), value)


def test_values_come_out_as_they_went_in():
    sent = status(3, with_keyframes=True)
    got = VisualInput(DataClock()).status(message_of(sent))
    assert (got.stamp_ns, got.state, got.segment, got.keyframe_id) == (sent.stamp_ns, sent.state, 2, 7)
    np.testing.assert_allclose(got.T_keyframe_camera, sent.T_keyframe_camera, atol=1e-15)
    assert (got.keyframes[0].keyframe_id, got.keyframes[0].stamp_ns) == (3, sent.stamp_ns)
    np.testing.assert_allclose(got.keyframes[0].T_world_camera, sent.T_world_camera, atol=1e-15)


def covariance():
    root = np.random.default_rng(3).normal(size=(6, 6))
    return root @ root.T


def test_the_covariance_comes_out_as_it_went_in_and_none_as_none():
    sent = replace(status(3), relative_covariance=covariance())
    np.testing.assert_allclose(
        VisualInput(DataClock()).status(message_of(sent)).relative_covariance, covariance(), rtol=1e-12
    )
    assert VisualInput(DataClock()).status(message_of(status(3))).relative_covariance is None


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (float("nan"), "not finite"),
        (float("inf"), "not finite"),
        (1e300, "has a number beyond 1e\\+16"),  # no eigenvalues are found of it
        (-1.0, "negative variances"),
    ],
)
def test_a_covariance_that_is_none_is_refused(value, words):
    message = message_of(replace(status(3), relative_covariance=covariance()))
    wrong = np.reshape(message.pose[0].covariance, (6, 6)).copy()
    wrong[0, 0] = value
    message.pose[0].covariance = wrong.ravel().tolist()
    with pytest.raises(ValueError, match=words):
        VisualInput(DataClock()).status(message)


def test_the_window_alone():
    sent = status(3, with_keyframes=True)
    header = Header(stamp=ros_time(sent.stamp_ns), frame_id="vo")
    got = VisualInput(DataClock()).window(Keyframes(header, status_message(header, sent).keyframes))
    assert (got.stamp_ns, got.state, got.segment) == (sent.stamp_ns, TrackingState.INITIALIZING, 2)
    assert [keyframe.keyframe_id for keyframe in got.keyframes] == [3]


def test_an_image_that_the_odometry_did_not_use_tells_nothing():
    last = message_of(status(0))
    assert VisualInput(DataClock()).status(no_pose_message(last.header, last, "torn")) is None


def test_a_pose_without_tracking_tells_nothing():
    message = message_of(status(0))
    message.state = message.LOST
    assert VisualInput(DataClock()).status(message) is None


def test_a_loss_has_no_pose():
    lost = OdometryStatus(START_NS, TrackingState.LOST, 0, message="dark")
    got = VisualInput(DataClock()).status(message_of(lost))
    assert (got.state, got.message, got.T_keyframe_camera, got.keyframe_id) == (TrackingState.LOST, "dark", None, -1)


def test_garbage_is_refused():
    message = message_of(status(0))
    message.pose[0].pose.orientation.w = float("nan")
    with pytest.raises(ValueError, match="not finite"):
        VisualInput(DataClock()).status(message)
    message = message_of(status(0))
    message.pose.append(RelativePose(keyframe_id=7, pose=Pose()))
    with pytest.raises(ValueError, match="2 poses of one image"):
        VisualInput(DataClock()).status(message)


def test_a_segment_that_cannot_be_published_is_refused():
    """fusion/scale has it as an int32."""
    message = message_of(status(3, with_keyframes=True))
    message.segment = 2**31
    with pytest.raises(ValueError, match="the segment 2147483648 is beyond 2147483647"):
        VisualInput(DataClock()).status(message)
    message = message_of(status(3, with_keyframes=True))
    message.keyframes[0].segment = 2**32 - 1
    with pytest.raises(ValueError, match="the segment 4294967295 is beyond"):
        VisualInput(DataClock()).status(message)
    with pytest.raises(ValueError, match="the segment 4294967295 is beyond"):
        VisualInput(DataClock()).window(Keyframes(message.header, message.keyframes))


def test_stamps_are_brought_onto_the_clock_of_the_wheels():
    """That was set back by a second; the keyframe is of the image before."""
    clock = DataClock()
    clock.take(START_NS)
    clock.take(START_NS + 20_000_000)
    clock.set_back(START_NS - 960_000_000)
    sent = status(0)
    image_ns, keyframe_ns = START_NS - 955_000_000, START_NS + 15_000_000
    message = message_of(
        OdometryStatus(
            image_ns,
            sent.state,
            2,
            sent.T_world_camera,
            keyframe_id=7,
            T_keyframe_camera=np.eye(4),
            keyframes=(KeyframeEstimate(7, keyframe_ns, 2, np.eye(4), (0.0, 0.0), False),),
        )
    )
    got = VisualInput(clock).status(message)
    assert got.stamp_ns == START_NS + 45_000_000
    assert got.keyframes[0].stamp_ns == keyframe_ns


def test_a_keyframe_keeps_its_time_after_the_clock_was_set_back():
    """By a second: 0.8 s later its stamp is nearer to now as a time after that."""
    clock = DataClock()
    clock.take(START_NS)
    visual = VisualInput(clock)
    keyframe = KeyframeEstimate(7, START_NS - 100_000_000, 2, np.eye(4), (0.0, 0.0), False)

    def heard(image_ns):
        T = np.eye(4)
        return visual.status(
            message_of(
                OdometryStatus(
                    image_ns, TrackingState.TRACKING, 2, T, keyframe_id=7, T_keyframe_camera=T, keyframes=(keyframe,)
                )
            )
        )

    assert heard(START_NS - 50_000_000).keyframes[0].stamp_ns == keyframe.stamp_ns
    clock.set_back(START_NS - 980_000_000)
    for k in range(1, 41):
        clock.take(START_NS - 980_000_000 + k * 20_000_000)
    later = heard(START_NS - 200_000_000)
    assert later.stamp_ns > START_NS + 700_000_000
    assert later.keyframes[0].stamp_ns == keyframe.stamp_ns


def window(index, *keyframes):
    """A status with these (identity, index of the image) in its window."""
    estimates = tuple(
        KeyframeEstimate(number, START_NS + image * 33_333_333, 2, np.eye(4), (0.0, 0.0), False)
        for number, image in keyframes
    )
    return message_of(replace(status(index), keyframes=estimates))


@pytest.mark.parametrize("comes_at_once", [True, False])
def test_a_keyframe_whose_image_has_a_wrong_stamp_has_no_place_in_time(comes_at_once):
    """Where the camera's clock was set back, another keyframe may have had the same stamp."""
    visual = VisualInput(DataClock())
    visual.status(window(9, (1, 5), (2, 9)))
    wrong = window(5, (1, 5), (2, 9), *([(3, 5)] if comes_at_once else []))
    visual.status(wrong)
    visual.distrust(wrong)
    for _ in range(2):
        got = visual.status(window(20, (1, 5), (2, 9), (3, 5), (4, 20)))
        assert [keyframe.keyframe_id for keyframe in got.keyframes] == [1, 2, 4]
    visual.reset()
    assert len(visual.status(window(20, (3, 5))).keyframes) == 1


def test_where_a_prediction_begins_comes_out_as_it_went_in_and_by_default_it_is_the_image():
    earlier_ns = START_NS - 5_000_000_000
    sent = OdometryStatus(START_NS, TrackingState.INITIALIZING, 2, earlier_start_ns=earlier_ns)
    assert VisualInput(DataClock()).status(message_of(sent)).predict_from_ns == earlier_ns
    message = message_of(replace(sent, earlier_start_ns=None))
    assert message.predict_from.to_nsec() == START_NS
    message.predict_from = ros_time(0)  # as of a node that does not ask for predictions
    assert VisualInput(DataClock()).status(message).predict_from_ns == START_NS
