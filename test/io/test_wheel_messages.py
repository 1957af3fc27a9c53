# SPDX-License-Identifier: BSD-3-Clause
import numpy as np

from ceiling_dso_ros.io.recording import WheelUnit
from ceiling_dso_ros.io.ros_messages import header, message, pose
from ceiling_dso_ros.io.wheel_joints import WheelJoints
from ceiling_dso_ros.io.wheel_messages import samples_of_counters, samples_of_joint_states, samples_of_odometry

MS = 1_000_000
NAMES = ["left_wheel", "right_wheel"]


def rows(samples):
    return [(stamp_ns // MS, *reading) for stamp_ns, *reading in samples]


def of_counters(counters):
    """The samples and what is said of them."""
    said = []
    return samples_of_counters(counters, "drive.bag, /l and /r", said.append), said


def test_counters_are_paired_as_the_node_does_it():
    samples, said = of_counters([("left", 0, 1), ("right", 3 * MS, 5), ("right", 20 * MS, 6), ("left", 22 * MS, 2)])
    assert samples.unit is WheelUnit.TICKS
    assert rows(samples) == [(3, 1, 5), (22, 2, 6)]
    assert samples.delay_ns == 0
    assert said == []


def test_a_counter_without_a_partner_is_dropped_and_said():
    counters = [("left", 0, 1), ("left", 20 * MS, 2), ("right", 22 * MS, 5), ("left", 500 * MS, 3)]
    samples, said = of_counters(counters)
    assert rows(samples) == [(22, 2, 5)]
    assert said == ["drive.bag, /l and /r: 1 of 4 messages are not used: the other wheel has none within 0.05 s"]
    assert of_counters(counters[:2])[0] is of_counters([])[0] is None


def state(stamp_ns, names, positions, velocities=()):
    fields = {"velocity": np.array(velocities, float), "effort": np.zeros(0)}
    head = header(stamp_ns, "")
    return message("sensor_msgs/JointState", header=head, name=names, position=np.array(positions, float), **fields)


def of_states(states, late_ns=0):
    said = []
    recorded = [(each.header.stamp.sec * 10**9 + each.header.stamp.nanosec + late_ns, each) for each in states]
    return samples_of_joint_states(recorded, WheelJoints(), "drive.bag, /joint_states", said.append), said


def test_states_of_other_joints_are_ignored_and_broken_ones_said():
    states = [
        state(MS, NAMES, [0.0, 2 * np.pi]),
        state(10 * MS, ["arm"], [1.0]),
        state(20 * MS, NAMES, [np.pi, np.nan]),
        state(30 * MS, NAMES, [np.pi, 4 * np.pi]),
        state(0, NAMES, [np.pi, 4 * np.pi]),
    ]
    samples, said = of_states(states, late_ns=5 * MS)
    assert samples.unit is WheelUnit.RADIANS
    assert rows(samples) == [(1, 0.0, 2 * np.pi), (30, np.pi, 4 * np.pi)]
    assert samples.delay_ns == 5 * MS
    assert samples.source == "drive.bag, /joint_states (left_wheel and right_wheel)"
    assert said == [
        f"{samples.source}: 1 of 4 messages are not used: the position of right_wheel is not finite",
        f"{samples.source}: 1 of 4 messages are not used: without a stamp",
    ]


def test_states_without_wheels_are_said():
    samples, said = of_states([state(MS, ["arm"], [1.0])])
    assert samples is None
    assert said == [
        "drive.bag, /joint_states: no left and right wheel among arm; name the wheels with left_joint and right_joint"
    ]


def test_velocities_alone_are_said():
    samples, said = of_states([state(stamp * MS, NAMES, [], [1.0, 1.0]) for stamp in (1, 2)])
    assert samples is None
    assert said == [
        "drive.bag, /joint_states (left_wheel and right_wheel): 2 of 2 messages are not used: left_wheel, right_wheel "
        "without a position, only velocities"
    ]


def test_states_whose_stamps_do_not_grow_are_dropped_and_said():
    samples, said = of_states([state(stamp * MS, NAMES, [stamp, 0.0]) for stamp in (1, 20, 20, 10, 30)])
    assert len(samples) == 3
    assert (np.diff(samples.stamps_ns) > 0).all()
    reason = "not later than the one before, or far ahead of the next"
    assert said == [f"{samples.source}: 2 of 5 messages are not used: {reason}"]
    assert not samples.set_back


def test_one_state_in_the_future_costs_one_state():
    stamps_ns = [20 * MS * k for k in range(50)]
    stamps_ns[20] += 3600 * 10**9
    samples, said = of_states([state(stamp_ns, NAMES, [0.0, 0.0]) for stamp_ns in stamps_ns])
    assert samples.stamps_ns.tolist() == stamps_ns[1:20] + stamps_ns[21:]  # the first has no stamp
    assert "1 of 50 messages are not used: not later" in said[0] + said[1]
    assert not samples.set_back


def test_a_clock_of_the_wheels_that_was_set_back_is_known():
    stamps_ns = [10**9 + 20 * MS * k for k in range(30)] + [10**9 + 20 * MS * k - 10**9 // 5 for k in range(30, 60)]
    assert of_states([state(stamp_ns, NAMES, [0.0, 0.0]) for stamp_ns in stamps_ns])[0].set_back


def odometry(stamp_ns, x, yaw, quaternion=None, child="base_link"):
    T = np.eye(4)
    T[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    T[0, 3] = x
    body = pose(T)
    for name, value in zip("xyzw", quaternion or ()):
        setattr(body.orientation, name, float(value))
    zero = {name: message("geometry_msgs/Vector3", x=0.0, y=0.0, z=0.0) for name in ("linear", "angular")}
    twist = message("geometry_msgs/Twist", **zero)
    covariance = {"covariance": np.zeros(36)}
    return message(
        "nav_msgs/Odometry",
        header=header(stamp_ns, "odom"),
        child_frame_id=child,
        pose=message("geometry_msgs/PoseWithCovariance", pose=body, **covariance),
        twist=message("geometry_msgs/TwistWithCovariance", twist=twist, **covariance),
    )


def of_odometry(messages):
    said = []
    recorded = [(each.header.stamp.nanosec, each) for each in messages]
    return samples_of_odometry(recorded, "base_link", "drive.bag, /odom", said.append), said


def test_poses_of_an_odometry_are_planar_and_its_quaternions_normalised():
    samples, said = of_odometry([odometry(MS, 1.0, 0.5), odometry(2 * MS, 2.0, 0.0, (0, 0, 2, 2), "base_footprint")])
    assert samples.unit is WheelUnit.POSES
    (_, first), (_, second) = samples
    np.testing.assert_allclose(first, [1.0, 0.0, 0.5])
    np.testing.assert_allclose(second, [2.0, 0.0, np.pi / 2])
    assert said == []


def test_poses_that_are_none_and_those_of_another_body_are_said():
    broken = odometry(2 * MS, np.nan, 0.0), odometry(3 * MS, 0.0, 0.0, (0, 0, 0, 0))
    samples, said = of_odometry([odometry(MS, 1.0, 0.0, child="/laser"), *broken, odometry(0, 1.0, 0.0)])
    assert len(samples) == 1
    assert said == [
        "drive.bag, /odom: the poses are those of laser, and are used as if they were those of base_link",
        "drive.bag, /odom: 1 of 4 messages are not used: the pose has a number that is not finite",
        "drive.bag, /odom: 1 of 4 messages are not used: the pose's quaternion is zero",
        "drive.bag, /odom: 1 of 4 messages are not used: without a stamp",
    ]
