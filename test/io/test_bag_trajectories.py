# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.io.bag_trajectories import read_trajectories
from ceiling_dso_ros.io.bag_writer import BagWriter
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.ros_messages import header, message, transform_stamped


def pose(x):
    T = np.eye(4)
    T[0, 3] = x
    return T


@pytest.fixture
def bag(tmp_path):
    path = tmp_path / "published.bag"
    with BagWriter(path) as writer:
        for second in (1, 2, 2, 3):  # one stamp twice
            stamp_ns = second * 10**9
            writer.odometry("/odometry/filtered", stamp_ns, "odom", "base_link", pose(second), np.zeros(3), np.zeros(3))
            writer.pose("/pose", stamp_ns, "vo", pose(10.0 * second))
        writer.pose("/pose", 4 * 10**9, "vo", pose(np.nan))
        far_too_late = header(99 * 10**9, "vo")
        at_home = transform_stamped(0, "vo", "camera", np.eye(4)).transform.rotation
        nowhere = message("geometry_msgs/Point", x=0.0, y=0.0, z=0.0)
        content = message("geometry_msgs/Pose", position=nowhere, orientation=at_home)
        late = message("geometry_msgs/PoseStamped", header=far_too_late, pose=content)
        writer.write("/pose", 15 * 10**8, late)
        null = transform_stamped(0, "vo", "camera", np.eye(4)).transform.rotation
        null.w = 0.0
        content = message(
            "geometry_msgs/Pose", position=message("geometry_msgs/Point", x=0.0, y=0.0, z=0.0), orientation=null
        )
        writer.write(
            "/pose", 5 * 10**9, message("geometry_msgs/PoseStamped", header=header(5 * 10**9, "vo"), pose=content)
        )
        writer.ticks("/ticks", 10**9, 5)
    return path


def test_poses_of_every_type(bag):
    trajectories = read_trajectories(bag, {"fused": "/odometry/filtered", "camera": "/pose", "nobody": "/nothing"})
    assert set(trajectories) == {"fused", "camera"}
    for name, gain in (("fused", 1.0), ("camera", 10.0)):
        assert trajectories[name].stamps_ns.tolist() == [10**9, 2 * 10**9, 3 * 10**9]
        assert trajectories[name].positions[:, 0].tolist() == [gain, 2.0 * gain, 3.0 * gain]


def test_what_is_left_out_is_said(bag):
    said = []
    of_the_stamp = "the stamp is out of order, or that of another message"
    read_trajectories(bag, {"fused": "/odometry/filtered", "camera": "/pose"}, said.append)
    assert said == [
        f"{bag}, /pose: 1 messages are left out: the pose has a number that is not finite",
        f"{bag}, /pose: 1 messages are left out: the pose's quaternion is zero",
        f"{bag}, /odometry/filtered: 1 messages are left out: {of_the_stamp}",
        f"{bag}, /pose: 2 messages are left out: {of_the_stamp}",
    ]


def test_topics_without_poses_are_named(bag):
    with pytest.raises(InputError, match="/ticks"):
        read_trajectories(bag, {"fused": "/ticks"})
