# SPDX-License-Identifier: BSD-3-Clause
"""A clock that nobody has set: fusion_node believes the turns of camera and wheels more than late messages."""

import numpy as np
import pytest

pytest.importorskip("ceiling_dso_ros.msg", reason="needs ROS and the built workspace")
pytestmark = pytest.mark.ros

from nav_msgs.msg import Odometry  # noqa: E402
from rosless import Rosless  # noqa: E402
from std_msgs.msg import Header  # noqa: E402

from ceiling_dso_ros.dso import KeyframeEstimate, OdometryStatus, TrackingState  # noqa: E402
from ceiling_dso_ros.fusion import planar  # noqa: E402
from ceiling_dso_ros.ros.conversions import pose_from_matrix, ros_time, status_message  # noqa: E402
from ceiling_dso_ros.ros.fusion_server import FusionServer  # noqa: E402

BEGIN_NS, HEIGHT_M = 1_732_800_000_123_456_789, 4.0
WHEELS_NS, IMAGE_NS = 20_000_000, 66_666_667
ROBOT = {
    "wheel_base": 0.5,
    "wheel_radius": [0.1, 0.1],
    "ticks_per_turn": 4096.0,
    "T_base_camera": {"xyz": [0.0, 0.0, 0.5], "quat_xyzw": [0.0, 0.0, 0.0, 1.0]},
}
STATUS, WHEELS = "visual_odometry/status", "wheel/odometry"


def pose_at(t_s):
    """(3,) of a robot on a winding way."""
    times_s = np.linspace(0.0, t_s, 200)
    yaw = 0.4 * np.sin(0.9 * times_s)
    x, y = (np.trapz(0.8 * side, times_s) for side in (np.cos(yaw), np.sin(yaw)))
    return np.array([x, y, yaw[-1]])


class Robot:
    """Its node hears wheels and images in the order of their stamps."""

    def __init__(self, monkeypatch, tmp_path):
        monkeypatch.setenv("ROS_HOME", str(tmp_path))
        self.world = Rosless(monkeypatch, robot=ROBOT)
        self.server = FusionServer()
        self.now_ns = 0
        self.server._order._now_ns = lambda: self.now_ns
        self.image = 0
        self.set_from, self.set_ns = 10**9, 0

    def stamp_ns(self, k):
        """Of an image, by a clock that may have been set."""
        return BEGIN_NS + k * IMAGE_NS + (self.set_ns if k >= self.set_from else 0)

    def drive(self, images, late_ns=0, step=1):
        """Further images; only those whose number `step` divides are used, and all come late."""
        for _ in range(images):
            stamp_ns = self.image * IMAGE_NS
            while self.now_ns < stamp_ns + late_ns:
                self.now_ns += WHEELS_NS
                message = Odometry(header=Header(stamp=ros_time(BEGIN_NS + self.now_ns), frame_id="odom"))
                message.pose.pose = pose_from_matrix(planar.lift(pose_at(1e-9 * self.now_ns)))
                self.world.callbacks[WHEELS](message)
            self.world.callbacks[STATUS](self.seen(self.image))
            self.image += step

    def seen(self, k):
        """What dso_node says of an image; every sixth is a keyframe."""
        key = k // 6
        poses = {number: self.camera(6 * number) for number in range(max(0, key - 6), key + 1)}
        keyframes = tuple(
            KeyframeEstimate(number, self.stamp_ns(6 * number), 0, T, (0.0, 0.0), False) for number, T in poses.items()
        )
        T = np.linalg.inv(poses[key]) @ self.camera(k)
        stamp_ns = self.stamp_ns(k)
        status = OdometryStatus(
            stamp_ns, TrackingState.TRACKING, 0, self.camera(k), keyframe_id=key, T_keyframe_camera=T,
            keyframes=keyframes if k % 6 == 0 else (),
        )  # fmt: skip
        return status_message(Header(stamp=ros_time(stamp_ns), frame_id="vo"), status)

    @staticmethod
    def camera(k):
        T = planar.lift(pose_at(1e-9 * k * IMAGE_NS))
        T[:3, 3] /= HEIGHT_M
        return T


@pytest.fixture
def robot(monkeypatch, tmp_path):
    robot = Robot(monkeypatch, tmp_path)
    yield robot
    robot.world.end()


def test_images_are_used_again_when_camera_and_wheels_turn_at_the_same_stamps(robot):
    robot.drive(90)
    robot.drive(160, late_ns=60_000_000, step=3)  # a busy computer, for longer than intervals are remembered
    robot.image -= 2
    robot.drive(1, late_ns=450_000_000)
    assert robot.server._order.disagrees
    rejected = robot.server._images.rejected
    robot.drive(60, late_ns=450_000_000)  # it stays so busy
    assert robot.server._images.rejected > rejected
    assert not robot.server._order.disagrees
    rejected = robot.server._images.rejected
    robot.drive(60, late_ns=450_000_000)
    assert robot.server._images.rejected == rejected
    assert "no clock was set" in " ".join(robot.world.logged)


@pytest.mark.parametrize("set_ns", [-400_000_000, -150_000_000, 300_000_000])
def test_images_of_a_clock_that_was_set_stay_unused(robot, set_ns):
    robot.drive(90)
    robot.set_from, robot.set_ns = robot.image, set_ns
    robot.drive(150)
    assert robot.server._order.disagrees
