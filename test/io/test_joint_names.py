# SPDX-License-Identifier: BSD-3-Clause
import pytest

from ceiling_dso_ros.io.joint_names import are_of_one_base, partner, wheel_pairs

FINGERS = ["gripper_left_finger_joint", "gripper_right_finger_joint"]


@pytest.mark.parametrize(
    ("left", "right"),
    [
        ("left_wheel", "right_wheel"),
        ("wheel_left_joint", "wheel_right_joint"),
        ("l_wheel_joint", "r_wheel_joint"),
        ("wheelLeft", "wheelRight"),
        ("WheelL", "WheelR"),
        ("LEFT_WHEEL", "RIGHT_WHEEL"),
        ("lwheel", "rwheel"),
        ("drivewhl_l_joint", "drivewhl_r_joint"),
        ("robot1/left_wheel", "robot1/right_wheel"),
        ("left", "right"),
        ("base_left_motor_joint", "base_right_motor_joint"),
    ],
)
def test_a_pair_of_wheels_is_found_among_other_joints(left, right):
    others = ["arm_1", *FINGERS, "head_pan", "left_shoulder", "right_shoulder"]
    assert wheel_pairs([*others, right, left]) == [(left, right)]
    assert partner(left, [*others, right, left]) == right


def test_the_only_wheel_of_each_side_is_found_whatever_it_is_called():
    assert wheel_pairs(["wheel_1_left", "wheel_2_right"]) == [("wheel_1_left", "wheel_2_right")]
    assert wheel_pairs(["wheel_1_left", "wheel_2_right", "wheel_3_left"]) == []


@pytest.mark.parametrize(
    "names",
    [
        FINGERS,
        ["left_finger", "right_finger"],
        ["left_jaw", "right_jaw"],
        ["front_left_steering_joint", "front_right_steering_joint"],
        ["left_wheel_steer", "right_wheel_steer"],
        ["left_caster_wheel", "right_caster_wheel"],
        ["fl_caster_l_wheel_joint", "fl_caster_r_wheel_joint"],
        ["left_flywheel", "right_flywheel"],
        ["left_joint1", "right_joint1", "left_joint2", "right_joint2"],
        ["upright_joint", "joint_left"],
        ["left_wheel"],
        [],
    ],
)
def test_other_pairs_are_no_wheels(names):
    assert wheel_pairs(names) == []


def test_wheels_count_more_than_a_pair_without_the_word():
    assert wheel_pairs(["left_motor", "right_motor", "left_wheel", "right_wheel"]) == [("left_wheel", "right_wheel")]


@pytest.mark.parametrize(
    "names",
    [
        ["front_left_wheel", "front_right_wheel", "rear_left_wheel", "rear_right_wheel"],
        ["wheel_front_left", "wheel_front_right", "wheel_back_left", "wheel_back_right"],
        ["fl_wheel", "fr_wheel", "rl_wheel", "rr_wheel"],
        ["lf_wheel", "rf_wheel", "lr_wheel", "rr_wheel"],
        ["left_wheel_1", "right_wheel_1", "left_wheel_2", "right_wheel_2"],
    ],
)
def test_wheels_of_several_axles_are_of_one_base(names):
    pairs = wheel_pairs(names)
    assert pairs == [tuple(names[:2]), tuple(names[2:])]
    assert are_of_one_base(pairs)


def test_other_pairs_are_not_of_one_base():
    pairs = wheel_pairs(["left_wheel", "right_wheel", "left_measuring_wheel", "right_measuring_wheel"])
    assert len(pairs) == 2
    assert not are_of_one_base(pairs)
    assert not are_of_one_base([])
