# SPDX-License-Identifier: BSD-3-Clause
"""Which of the wheel data of a bag is used, and what is said of the rest."""

import re

import numpy as np
import pytest

from ceiling_dso_ros.io.bag_writer import BagWriter
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.opening import open_recording
from ceiling_dso_ros.io.recording import TopicNames, WheelUnit

START_NS, MS = 1_700_000_001_000_000_000, 1_000_000
K = np.array([[60.0, 0, 47.5], [0, 61.0, 39.5], [0, 0, 1]])
WHEELS = ["wheel_left", "wheel_right"]


def ticks(bag, stamp_ns, topics=("/wheel/left/ticks", "/wheel/right/ticks")):
    for topic in topics:
        bag.ticks(topic, stamp_ns, 7)


def joint_states(bag, stamp_ns, topic="/joint_states", names=WHEELS):
    bag.joint_state(topic, stamp_ns, names, np.arange(len(names)))


def odometry(bag, stamp_ns, topic="/odom"):
    bag.odometry(topic, stamp_ns, "odom", "base_link", np.eye(4), np.zeros(3), np.zeros(3))


@pytest.fixture
def wheels(tmp_path):
    """Reads the wheels of a bag with some writers' messages; gives them, and what was said."""

    def read(*writers, **topics):
        with BagWriter(tmp_path / "tour.bag") as bag:
            bag.camera_info("/camera/up/camera_info", START_NS, "optical", (96, 80), K)
            bag.image("/camera/up/image_raw", START_NS, "optical", np.full((80, 96), 100, np.uint8))
            for index in range(3):
                for write in writers:
                    write(bag, START_NS + index * MS)
        said = []
        return open_recording(tmp_path / "tour.bag", TopicNames(**topics), warn=said.append).wheels, said

    return read


@pytest.mark.parametrize(
    ("writers", "topics", "unit"),
    [
        ((ticks, joint_states, odometry), {}, WheelUnit.TICKS),
        ((joint_states, odometry), {}, WheelUnit.RADIANS),
        ((ticks, joint_states), {"wheel_input": "joint_states"}, WheelUnit.RADIANS),
        ((ticks, joint_states, odometry), {"wheel_input": "odometry"}, WheelUnit.POSES),
    ],
)
def test_what_is_asked_for_is_used_else_ticks_else_joint_states(wheels, writers, topics, unit):
    samples, said = wheels(*writers, **topics)
    assert (samples.unit, len(samples), said) == (unit, 3, [])


def test_an_odometry_is_not_used_unasked_but_said(wheels, tmp_path):
    samples, said = wheels(odometry)
    assert samples is None
    assert said == [
        f"{tmp_path}/tour.bag: no wheels are used; the bag has nav_msgs/Odometry on /odom (use it with "
        "--wheel-odometry /odom)"
    ]


def test_other_topics_that_could_be_the_wheels_are_said(wheels, tmp_path):
    def elsewhere(bag, stamp_ns):
        joint_states(bag, stamp_ns, "/robot/joint_states")
        ticks(bag, stamp_ns, ["/wheel/left/ticks"])

    samples, said = wheels(elsewhere)
    assert samples is None
    assert said == [
        f"{tmp_path}/tour.bag: no wheels are used; the bag has sensor_msgs/JointState on /robot/joint_states (use it "
        "with --joint-states /robot/joint_states), std_msgs/Int32 on /wheel/left/ticks (use it with --left-ticks "
        "/wheel/left/ticks)"
    ]
    assert wheels(elsewhere, joint_states="/robot/joint_states")[0].unit is WheelUnit.RADIANS


def test_a_bag_of_a_camera_alone_says_nothing(wheels):
    assert wheels() == (None, [])


@pytest.mark.parametrize(
    ("topics", "complaint"),
    [
        (
            {"wheel_input": "odometry", "wheel_odometry": "/my"},
            "/my not in the bag; its topics of nav_msgs/Odometry: /odom",
        ),
        (
            {"wheel_input": "ticks"},
            "/wheel/left/ticks and /wheel/right/ticks not in the bag; its topics of std_msgs/Int32: none",
        ),
        (
            {"wheel_input": "joint_states"},
            "no samples on /joint_states that can be used, as said above",
        ),
    ],
)
def test_what_is_asked_for_and_not_there_is_an_error(wheels, tmp_path, topics, complaint):
    def arm(bag, stamp_ns):
        joint_states(bag, stamp_ns, names=["arm_1", "arm_2"])

    with pytest.raises(InputError, match=re.escape(f"{tmp_path}/tour.bag: {complaint}")):
        wheels(odometry, arm, **topics)
