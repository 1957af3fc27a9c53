# SPDX-License-Identifier: BSD-3-Clause
"""What wheel_odometry_node makes of joint_states that several nodes publish; without a master."""

import threading

import numpy as np
import pytest

pytest.importorskip("ceiling_dso_ros.msg", reason="needs ROS and the built workspace")
pytestmark = pytest.mark.ros

import rospy  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import Header  # noqa: E402
from straight_drive import Drive  # noqa: E402

from ceiling_dso_ros.fusion.config import RobotModel, WheelConfig  # noqa: E402
from ceiling_dso_ros.fusion.wheel import WheelOdometry  # noqa: E402
from ceiling_dso_ros.io.wheel_joints import WheelJoints  # noqa: E402
from ceiling_dso_ros.ros import diagnostics, run_clock  # noqa: E402
from ceiling_dso_ros.ros.conversions import ros_time  # noqa: E402
from ceiling_dso_ros.ros.senders import Senders  # noqa: E402
from ceiling_dso_ros.ros.wheel_server import WheelServer  # noqa: E402

WHEELS = ["front_left_wheel", "front_right_wheel", "rear_left_wheel", "rear_right_wheel"]
FINGERS = ["gripper_left_finger_joint", "gripper_right_finger_joint"]


@pytest.fixture
def server(monkeypatch):
    """A server that is not connected; `published` are its messages."""
    monkeypatch.setattr(rospy, "get_time", lambda: 10.0)
    monkeypatch.setattr(run_clock, "time_is_simulated", lambda: False)
    monkeypatch.setattr(rospy, "loginfo", lambda *_: None)
    monkeypatch.setattr(rospy, "logwarn_throttle", lambda *_: None)
    server = WheelServer.__new__(WheelServer)
    server._lock, server._clock, server._samples = threading.Lock(), run_clock.RunClock(), diagnostics.Stream(0.5)
    server._joints, server._senders = WheelJoints(), Senders()
    server._odometry = WheelOdometry(RobotModel(np.eye(4), 0.5), WheelConfig())
    server._odom_frame, server._base_frame, server._broadcaster = "odom", "base_link", None
    server.published = []
    server._publisher = type("Publisher", (), {"publish": staticmethod(server.published.append)})
    return server


def hear(server, stamp_s, names, positions, velocities=(), sender="/base"):
    header = Header(stamp=rospy.Time.from_sec(stamp_s))
    message = JointState(header=header, name=names, position=positions, velocity=velocities)
    message._connection_header = {"callerid": sender}
    server._on_joint_states(message)
    return len(server.published)


def test_a_gripper_on_the_same_topic_is_never_taken_for_the_wheels(server):
    assert hear(server, 1.0, FINGERS, [0.02, 0.02]) == 0
    assert "no left and right wheel among gripper_left_finger_joint" in server._samples.complaint
    assert hear(server, 1.01, WHEELS, [0.0] * 4) == 1
    rejected = server._samples.rejected
    assert hear(server, 1.02, FINGERS, [0.5, 0.02]) == 1
    assert hear(server, 1.03, WHEELS, [0.1, 0.1, 0.1, 0.1]) == 2
    assert server._samples.rejected == rejected
    assert server.published[-1].pose.pose.position.x == pytest.approx(0.1 * 0.1)


def test_wheels_that_have_gone_are_named(server, monkeypatch):
    hear(server, 1.0, WHEELS[:2], [0.0, 0.0])
    monkeypatch.setattr(rospy, "get_time", lambda: 11.0)
    hear(server, 2.0, FINGERS, [0.0, 0.0])
    assert "a message without front_left_wheel and front_right_wheel; name the wheels" in server._samples.complaint


def test_two_nodes_that_send_the_wheels_in_turn_are_named(server):
    hear(server, 1.0, WHEELS, [0.0] * 4)
    hear(server, 1.01, WHEELS, [0.0] * 4, sender="/joint_state_publisher")
    assert not server._samples.complaint  # it may have taken over
    hear(server, 1.02, WHEELS, [0.1] * 4)
    assert "/joint_state_publisher and /base send them in turn: switch one off" in server._samples.complaint
    assert "front_left_wheel" in server._samples.complaint


def test_a_node_that_is_started_again_under_another_name_is_no_second_one(server):
    for k, sender in enumerate(["/base"] * 3 + ["/base_2"] * 3):
        hear(server, 1.0 + 0.01 * k, WHEELS, [0.0] * 4, sender=sender)
    assert not server._samples.complaint


@pytest.mark.parametrize(
    ("stamp_s", "positions", "velocities", "complaint"),
    [
        (1.0, [np.nan, 0.0, 0.0, 0.0], [], "the position of front_left_wheel is not finite"),
        (1.0, [], [1.0] * 4, "without a position, only velocities"),
        (0.0, [0.0] * 4, [], "a message without a stamp"),
    ],
)
def test_wheels_that_cannot_be_used_are_said(server, stamp_s, positions, velocities, complaint):
    assert hear(server, stamp_s, WHEELS, positions, velocities) == 0
    assert complaint in server._samples.complaint


def test_wheels_whose_first_angles_are_not_finite(rosless):
    world = rosless(robot={"ticks_per_turn": 4096.0, "wheel_radius": [0.1, 0.1], "wheel_base": 0.5})
    server = WheelServer()
    stamp_ns = Drive.BEGIN_NS
    for left, right in ((float("nan"), 0.0), (1.0, 1.0), (1.1, 1.1)):
        stamp_ns += 20_000_000
        header = Header(stamp=ros_time(stamp_ns))
        world.callbacks["joint_states"](JointState(header, ["left_wheel", "right_wheel"], [left, right], [], []))
    assert world.sent["wheel/odometry"] == 2
    assert world.newest["wheel/odometry"].header.stamp == ros_time(stamp_ns)
    assert server._samples.rejected == 1
