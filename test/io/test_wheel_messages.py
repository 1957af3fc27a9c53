# SPDX-License-Identifier: BSD-3-Clause
import numpy as np

from ceiling_dso_ros.io.recording import WheelUnit
from ceiling_dso_ros.io.ros_messages import header, message
from ceiling_dso_ros.io.wheel_joints import WheelJoints
from ceiling_dso_ros.io.wheel_messages import samples_of_counters, samples_of_joint_states

MS = 1_000_000


def rows(samples):
    return [(stamp_ns // MS, left, right) for stamp_ns, left, right in samples]


def test_counters_are_paired_as_the_node_does_it():
    counters = [("left", 0, 1), ("right", 3 * MS, 5), ("right", 20 * MS, 6), ("left", 22 * MS, 2)]
    samples = samples_of_counters(counters)
    assert samples.unit is WheelUnit.TICKS
    assert rows(samples) == [(3, 1, 5), (22, 2, 6)]


def test_a_counter_without_a_partner_is_dropped():
    counters = [("left", 0, 1), ("left", 20 * MS, 2), ("right", 22 * MS, 5), ("left", 500 * MS, 3)]
    assert rows(samples_of_counters(counters)) == [(22, 2, 5)]
    assert samples_of_counters(counters[:2]) is None
    assert samples_of_counters([]) is None


def state(stamp_ns, names, positions):
    fields = {"velocity": np.zeros(0), "effort": np.zeros(0)}
    return message(
        "sensor_msgs/JointState", header=header(stamp_ns, ""), name=names, position=np.array(positions), **fields
    )


def test_joint_states_without_both_wheels_are_left_out():
    names = ["left_wheel", "right_wheel"]
    states = [
        state(0, names, [0.0, 2 * np.pi]),
        state(10 * MS, ["arm"], [1.0]),
        state(20 * MS, names, [np.pi, np.nan]),
        state(30 * MS, names, [np.pi, 4 * np.pi]),
    ]
    samples = samples_of_joint_states(states, WheelJoints())
    assert samples.unit is WheelUnit.RADIANS
    assert rows(samples) == [(0, 0.0, 2 * np.pi), (30, np.pi, 4 * np.pi)]
    assert samples_of_joint_states(states[1:2], WheelJoints()) is None


def test_states_whose_stamps_do_not_grow_are_dropped():
    names = ["left_wheel", "right_wheel"]
    states = [state(stamp * MS, names, [stamp, 0.0]) for stamp in (0, 20, 20, 10, 30)]
    assert rows(samples_of_joint_states(states, WheelJoints())) == [(0, 0.0, 0.0), (20, 20.0, 0.0), (30, 30.0, 0.0)]
