import numpy as np

from ceiling_dso_ros.io.ros_messages import header, message
from ceiling_dso_ros.io.wheel_messages import ticks_of_counters, ticks_of_joint_states

MS = 1_000_000


def rows(ticks):
    return np.stack([ticks.stamps_ns // MS, ticks.left, ticks.right], axis=1).tolist()


def test_counters_of_the_same_stamps_are_paired():
    ticks = ticks_of_counters([(0, 1), (20 * MS, 2)], [(0, 5), (20 * MS, 6)])
    assert rows(ticks) == [[0, 1, 5], [20, 2, 6]]


def test_every_left_value_gets_the_nearest_right_one():
    left = [(0, 1), (20 * MS, 2), (40 * MS, 3), (60 * MS, 4)]
    right = [(3 * MS, 5), (22 * MS, 6), (39 * MS, 7)]  # the fourth was lost
    assert rows(ticks_of_counters(left, right)) == [[0, 1, 5], [20, 2, 6], [40, 3, 7], [60, 4, 7]]


def test_values_without_a_partner_are_dropped():
    ticks = ticks_of_counters([(0, 1), (500 * MS, 2)], [(10 * MS, 5), (700 * MS, 6)])
    assert rows(ticks) == [[0, 1, 5]]
    assert ticks_of_counters([(0, 1)], [(500 * MS, 5)]) is None
    assert ticks_of_counters([], [(0, 1)]) is None


def test_stamps_that_do_not_grow_are_dropped():
    left = [(0, 1), (20 * MS, 2), (20 * MS, 3), (10 * MS, 4), (30 * MS, 5)]
    right = [(0, 1), (20 * MS, 2), (30 * MS, 3)]
    assert rows(ticks_of_counters(left, right)) == [[0, 1, 1], [20, 2, 2], [30, 5, 3]]


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
    assert rows(ticks_of_joint_states(states, 4096)) == [[0, 0, 4096], [30, 2048, 8192]]
    assert ticks_of_joint_states(states[1:2], 4096) is None
