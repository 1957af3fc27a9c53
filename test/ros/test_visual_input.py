import numpy as np
import pytest

pytest.importorskip("ceiling_dso_ros.msg", reason="needs ROS and the built workspace")
pytestmark = pytest.mark.ros

from std_msgs.msg import Header  # noqa: E402

from ceiling_dso_ros.dso import KeyframeEstimate, OdometryStatus, TrackingState  # noqa: E402
from ceiling_dso_ros.io.stamps import seconds  # noqa: E402
from ceiling_dso_ros.ros.conversions import keyframes_message, ros_time, status_message  # noqa: E402
from ceiling_dso_ros.ros.visual_input import LONGEST_WAIT, VisualInput  # noqa: E402

START_NS = 1_700_000_000_123_456_789


def status(index, with_keyframes=False):
    stamp_s = seconds(START_NS + index * 33_333_333)
    T = np.eye(4)
    T[0, 3] = 0.1 * index
    keyframes = (KeyframeEstimate(index, stamp_s, 2, T, (0.1, 0.2), False),) if with_keyframes else ()
    return OdometryStatus(
        stamp_s, TrackingState.TRACKING, 2, T, keyframe_id=7, T_keyframe_camera=T, keyframes=keyframes, message="words"
    )


def messages(value):
    header = Header(stamp=ros_time(value.stamp_s), frame_id="vo")
    return status_message(header, value), keyframes_message(header, value.keyframes)


def test_values_come_out_as_they_went_in():
    sent = status(3, with_keyframes=True)
    message, keyframes = messages(sent)
    visual = VisualInput()
    assert visual.add_status(message) == []
    (got,) = visual.add_keyframes(keyframes)
    assert (got.stamp_s, got.state, got.segment, got.keyframe_id) == (sent.stamp_s, sent.state, 2, 7)
    np.testing.assert_allclose(got.T_keyframe_camera, sent.T_keyframe_camera, atol=1e-15)
    assert (got.keyframes[0].keyframe_id, got.keyframes[0].stamp_s) == (3, sent.stamp_s)
    np.testing.assert_allclose(got.keyframes[0].T_world_camera, sent.T_world_camera, atol=1e-15)


@pytest.mark.parametrize("keyframes_first", [False, True])
def test_order_is_kept_whichever_connection_is_faster(keyframes_first):
    visual = VisualInput()
    first, keyframes = messages(status(0, with_keyframes=True))
    second, _ = messages(status(1))
    got = []
    if keyframes_first:
        got += visual.add_keyframes(keyframes)
    got += visual.add_status(first)
    got += visual.add_status(second)
    if not keyframes_first:
        got += visual.add_keyframes(keyframes)
    assert [value.stamp_s for value in got] == [status(0).stamp_s, status(1).stamp_s]
    assert [len(value.keyframes) for value in got] == [1, 0]


def test_keyframes_that_never_come_do_not_hold_everything_up():
    visual = VisualInput()
    got = visual.add_status(messages(status(0, with_keyframes=True))[0])
    for index in range(1, LONGEST_WAIT + 1):
        got += visual.add_status(messages(status(index))[0])
    assert len(got) == LONGEST_WAIT + 1


def test_garbage_is_refused_and_what_follows_is_taken():
    visual = VisualInput()
    message, _ = messages(status(0))
    message.pose_in_keyframe.orientation.w = float("nan")
    with pytest.raises(ValueError, match="not finite"):
        visual.add_status(message)
    assert len(visual.add_status(messages(status(1))[0])) == 1


def test_no_pose_needs_none():
    lost = OdometryStatus(1.0, TrackingState.LOST, 0, message="dark")
    (got,) = VisualInput().add_status(messages(lost)[0])
    assert (got.state, got.message, got.T_keyframe_camera) == (TrackingState.LOST, "dark", None)
