# SPDX-License-Identifier: BSD-3-Clause
"""The second camera of dso_node: what comes in any order, late or not at all."""

import numpy as np
import pytest

pytest.importorskip("ceiling_dso_ros.msg", reason="needs ROS and the built workspace")
pytestmark = pytest.mark.ros

from geometry_msgs.msg import Transform, TransformStamped  # noqa: E402
from rosless import Rosless  # noqa: E402
from sensor_msgs.msg import CameraInfo, Image  # noqa: E402
from std_msgs.msg import Header  # noqa: E402
from tf2_msgs.msg import TFMessage  # noqa: E402

from ceiling_dso_ros.io.errors import FrameError  # noqa: E402
from ceiling_dso_ros.ros.conversions import ros_time  # noqa: E402
from ceiling_dso_ros.ros.right_input import KEPT_NS, RightInput  # noqa: E402

WIDTH, HEIGHT, BEGIN_NS, PERIOD_NS = 96, 80, 1_700_000_001_030_042_017, 33_333_333
TOPIC = "/right/image"


class Cameras:
    def __init__(self, monkeypatch):
        self.world = Rosless(monkeypatch)
        self.right = RightInput("raw", rectified=False)
        self.world.listened.add(TOPIC)

    def see(self, index, frame="right"):
        stamp = ros_time(BEGIN_NS + index * PERIOD_NS)
        pixels = np.full((HEIGHT, WIDTH), index % 256, np.uint8)
        message = Image(Header(stamp=stamp, frame_id=frame), HEIGHT, WIDTH, "mono8", 0, WIDTH, pixels.tobytes())
        self.world.callbacks[TOPIC](message)

    def calibrate(self, baseline_m=0.0, fx=60.0):
        K = [fx, 0.0, 47.5, 0.0, 60.0, 39.5, 0.0, 0.0, 1.0]
        P = [fx, 0.0, 47.5, -fx * baseline_m, 0.0, 60.0, 39.5, 0.0, 0.0, 0.0, 1.0, 0.0]
        model = {"distortion_model": "plumb_bob", "D": [0.0] * 5}
        self.world.callbacks["right/camera_info"](CameraInfo(width=WIDTH, height=HEIGHT, K=K, P=P, **model))

    def place(self, x=0.05, child="right"):
        transform = TransformStamped(Header(frame_id="left"), child, Transform())
        transform.transform.translation.x, transform.transform.rotation.w = x, 1.0
        self.world.callbacks["/tf_static"](TFMessage([transform]))

    def camera(self):
        return self.right.camera("left", 0.0)


@pytest.fixture
def cameras(monkeypatch):
    monkeypatch.setattr("ceiling_dso_ros.ros.right_input.TIMEOUT_S", 0.01)
    return Cameras(monkeypatch)


def test_nobody_publishes_right_images(cameras):
    cameras.world.listened.clear()
    cameras.calibrate(0.095)
    assert cameras.camera() is None
    assert cameras.right.later(BEGIN_NS) is None
    assert cameras.right.complaint == ""


def test_where_it_is_by_tf_or_else_by_camera_info(cameras):
    cameras.see(0)
    assert cameras.camera() is None
    cameras.calibrate(0.095)
    first = cameras.camera()
    np.testing.assert_allclose(first.T_left_right[:3, 3], [0.095, 0.0, 0.0])
    assert cameras.camera() is first
    cameras.place(0.05)
    np.testing.assert_allclose(cameras.camera().T_left_right[:3, 3], [0.05, 0.0, 0.0])


def test_a_calibration_that_changes_is_another_camera(cameras):
    cameras.see(0)
    cameras.calibrate(0.095)
    first = cameras.camera()
    cameras.calibrate(0.095)
    assert cameras.camera() is first
    cameras.calibrate(0.095, fx=61.0)
    assert cameras.camera() is not first


def test_what_is_missing_is_said(cameras):
    cameras.see(0)
    cameras.calibrate()
    assert cameras.camera() is None
    assert "neither tf nor P" in cameras.right.complaint
    cameras.place()
    assert cameras.camera() is not None
    assert cameras.right.complaint == ""


def test_images_are_found_by_their_stamps(cameras):
    cameras.calibrate(0.095)
    for index in range(3):
        cameras.see(index)
    cameras.camera()
    for index in (2, 0, 1):
        image = cameras.right.later(BEGIN_NS + index * PERIOD_NS)()
        assert image.shape == (HEIGHT, WIDTH)
        assert (image == index).all()


def test_an_image_may_come_after_it_was_asked_for(cameras):
    cameras.calibrate(0.095)
    cameras.see(0)
    cameras.camera()
    later = cameras.right.later(BEGIN_NS + PERIOD_NS)
    with pytest.raises(FrameError, match="no image of this moment"):
        later()
    cameras.see(1)
    assert (later() == 1).all()


def test_old_images_are_forgotten(cameras):
    """Not those of the last second, since images of the first camera may wait, too."""
    cameras.calibrate(0.095)
    kept = KEPT_NS // PERIOD_NS
    for index in range(kept + 5):
        cameras.see(index)
    cameras.camera()
    assert cameras.right.later(BEGIN_NS + 6 * PERIOD_NS)() is not None
    with pytest.raises(FrameError):
        cameras.right.later(BEGIN_NS)()
