# SPDX-License-Identifier: BSD-3-Clause
import math

import numpy as np
import pytest

from ceiling_dso_ros.io.wheel_joints import WheelJoints

WHEELS = ["wheel_left", "wheel_right"]
FINGERS = ["gripper_left_finger", "gripper_right_finger"]
FOUR = ["front_left_wheel", "front_right_wheel", "rear_left_wheel", "rear_right_wheel"]
MS = 1_000_000


def test_the_wheels_are_read_and_other_joints_and_messages_ignored():
    joints = WheelJoints()
    assert joints.read(1, FINGERS, [9.0, 9.0]) is None
    assert joints.complaint == ""
    assert "no left and right wheel among gripper_left_finger, gripper_right_finger" in joints.missing
    assert joints.read(2, [*FINGERS, "wheel_right", "wheel_left"], [9.0, 9.0, 2.0, 1.0]) == (2, 1.0, 2.0)
    assert joints.read(3, FINGERS, [9.0, 9.0]) is None
    assert (joints.complaint, joints.missing) == ("", "")
    assert joints.pairs == [tuple(WHEELS)]


def test_several_pairs_are_no_wheels_unless_they_are_named():
    names = [*WHEELS, "measuring_wheel_left", "measuring_wheel_right"]
    joints = WheelJoints()
    assert joints.read(1, names, [1.0, 2.0, 3.0, 4.0]) is None
    assert joints.missing == (
        "several pairs of joints could be the wheels: wheel_left and wheel_right, or measuring_wheel_left and "
        "measuring_wheel_right; name the wheels with left_joint and right_joint"
    )
    assert WheelJoints(left_joint="wheel_left").read(1, names, [1.0, 2.0, 3.0, 4.0]) == (1, 1.0, 2.0)
    assert WheelJoints(right_joint="wheel_right").read(1, names, [1.0, 2.0, 3.0, 4.0]) == (1, 1.0, 2.0)
    assert WheelJoints(*names[2:]).read(1, names, [1.0, 2.0, 3.0, 4.0]) == (1, 3.0, 4.0)
    assert WheelJoints(*FINGERS).read(1, [*names, *FINGERS], range(6)) == (1, 4, 5)


@pytest.mark.parametrize(
    ("given", "missing"),
    [
        (("port", "starboard"), "port (--left) and starboard (--right) are not among "),
        (("port", "wheel_right"), "port (--left) is not among "),
        (("wheel_left", "starboard"), "starboard (--right) is not among "),
        (("port", ""), "port (--left) is not among "),
        (("", "starboard"), "starboard (--right) is not among "),
    ],
)
def test_names_that_are_not_there_are_said(given, missing):
    joints = WheelJoints(*given, options=("--left", "--right"))
    assert joints.read(1, WHEELS, [1.0, 2.0]) is None
    assert joints.missing == f"{missing}wheel_left, wheel_right"


def test_a_named_wheel_without_a_counterpart_is_said():
    joints = WheelJoints(right_joint="arm")
    assert joints.read(1, [*WHEELS, "arm"], [1.0, 2.0, 3.0]) is None
    assert joints.missing == "arm has no counterpart among wheel_left, wheel_right, arm; name it with left_joint"


def test_a_pair_that_turns_up_later_is_not_taken_but_said():
    joints = WheelJoints()
    assert joints.read(1, ["left", "right"], [1.0, 2.0]) == (1, 1.0, 2.0)
    assert joints.read(2, WHEELS, [5.0, 6.0]) is None
    assert joints.complaint.startswith("left and right are used as the wheels, it could be wheel_left and wheel_right")
    assert joints.read(3, ["left", "right"], [1.5, 2.5]) == (3, 1.5, 2.5)
    assert joints.complaint == ""


@pytest.mark.parametrize(
    ("positions", "velocities", "complaint"),
    [
        ([], [1.0, 2.0], "wheel_left, wheel_right without a position, only velocities"),
        ([1.0], [], "wheel_right without a position, and no positions"),
        ([1.0, math.nan], [], "the position of wheel_right is not finite"),
        ([math.inf, 1.0], [], "the position of wheel_left is not finite"),
        ([1.0, 1e300], [], "the position of wheel_right is 1e+300, which is no angle of a wheel"),
    ],
)
def test_wheels_without_a_position_are_said(positions, velocities, complaint):
    joints = WheelJoints()
    assert joints.read(1, WHEELS, positions, velocities) is None
    assert joints.complaint == complaint
    assert joints.read(2, WHEELS, [1.0, 2.0]) == (2, 1.0, 2.0)
    assert joints.complaint == ""


def test_wheels_whose_messages_come_separately_are_paired():
    joints = WheelJoints()
    messages = [(0, "left"), (2, "right"), (20, "left"), (22, "right"), (40, "left"), (42, "right"), (500, "right")]
    read = [joints.read(stamp * MS, [f"wheel_{side}"], [0.1 * stamp]) for stamp, side in messages]
    assert read[:3] == [None, None, (20 * MS, 2.0, 0.2)]
    assert read[3:] == [None, None, (42 * MS, 4.0, pytest.approx(4.2)), None]


def four_wheels(rear_share, wrapped):
    """What is read while all wheels turn ten times, the rear ones by a share of that; and what was said."""
    joints, angles, said = WheelJoints(), [], []
    for index in range(2001):
        front = 0.01 * np.pi * index
        positions = np.array([front, -front, 1.0 + rear_share * front, 1.0 - rear_share * front])
        if wrapped:
            positions = np.angle(np.exp(1j * positions))
        angles.append(joints.read(index, FOUR, positions)[1:])
        said += [joints.complaint] if joints.complaint else []
    return np.unwrap(np.array(angles), axis=0), said


@pytest.mark.parametrize("wrapped", [False, True])
def test_a_base_with_four_wheels_counts_as_one_with_their_mean(wrapped):
    angles, said = four_wheels(1.04, wrapped)
    np.testing.assert_allclose(angles[-1] - angles[0], [20.4 * np.pi, -20.4 * np.pi])
    assert said == []


def test_wheels_of_one_side_that_roll_differently_are_said_once():
    _, said = four_wheels(0.7, False)
    assert said[0].startswith("front_left_wheel and rear_left_wheel roll differently, by 30%, and their mean is used")
    assert len(said) <= 2  # one of each side
