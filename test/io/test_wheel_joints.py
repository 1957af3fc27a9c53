# SPDX-License-Identifier: BSD-3-Clause
from ceiling_dso_ros.io.wheel_joints import WheelJoints

NAMES = ["gripper_left", "wheel_right", "wheel_left"]


def test_the_only_joint_that_names_its_side_is_the_wheel():
    assert WheelJoints().angles_rad(NAMES[1:], [2.0, 1.0]) == (1.0, 2.0)


def test_several_joints_of_a_side_are_no_wheel_unless_one_is_named():
    assert WheelJoints().angles_rad(NAMES, [9.0, 2.0, 1.0]) is None
    assert WheelJoints(left_joint="wheel_left").angles_rad(NAMES, [9.0, 2.0, 1.0]) == (1.0, 2.0)


def test_a_missing_wheel_is_none():
    assert WheelJoints().angles_rad(["arm", "wheel_left"], [0.0, 1.0]) is None
    assert WheelJoints("front_left", "front_right").angles_rad(NAMES, [9.0, 2.0, 1.0]) is None
    assert WheelJoints().angles_rad(NAMES[1:], [2.0]) is None
