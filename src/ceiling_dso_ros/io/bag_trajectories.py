# SPDX-License-Identifier: BSD-3-Clause
"""Trajectories from recorded pose topics."""

from pathlib import Path
from typing import Callable, Counter, Dict, List, Tuple

import numpy as np

from ceiling_dso_ros.io.bag_contents import BagContents
from ceiling_dso_ros.io.bag_reader import read_messages
from ceiling_dso_ros.io.errors import FrameError, InputError
from ceiling_dso_ros.io.ros_messages import RosMessage, header_stamp_ns, pose_matrix
from ceiling_dso_ros.io.stamps import longest_increasing
from ceiling_dso_ros.io.trajectory import Trajectory
from ceiling_dso_ros.io.warning_log import ignore_warning

POSE_OF: Dict[str, Callable[[RosMessage], RosMessage]] = {
    "nav_msgs/msg/Odometry": lambda message: message.pose.pose,
    "geometry_msgs/msg/PoseStamped": lambda message: message.pose,
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda message: message.pose.pose,
}


def pose_topics(path: Path) -> List[str]:
    """Topics of a bag whose messages have a pose, sorted.

    Raises:
        InputError: the bag cannot be read.
    """
    return BagContents(path).of_type(*POSE_OF)


def read_trajectories(
    path: Path, topics: Dict[str, str], warn: Callable[[str], None] = ignore_warning
) -> Dict[str, Trajectory]:
    """Read the poses of some topics.

    Damaged messages, poses that are none, and as few as possible so that the stamps increase, are left out.

    Args:
        path: a ROS 1 bag.
        topics: name -> topic of nav_msgs/Odometry, geometry_msgs/PoseStamped or PoseWithCovarianceStamped.
        warn: is told how many messages of a topic are left out, and why.

    Returns:
        Name -> trajectory, of those topics that have poses.

    Raises:
        InputError: the bag cannot be read, or a topic has messages of another type.
    """
    rows: Dict[str, List[Tuple[int, List[float]]]] = {topic: [] for topic in topics.values()}
    left_out = Counter[Tuple[str, str]]()
    for raw in read_messages(path, list(rows)):
        if raw.message_type not in POSE_OF:
            raise InputError(f"{path}, {raw.topic}: {raw.message_type} has no pose; {', '.join(POSE_OF)} have")
        known = rows[raw.topic]
        try:
            message = raw.content()
            pose = POSE_OF[raw.message_type](message)
            pose_matrix(pose.position, pose.orientation)
        except (FrameError, ValueError) as error:
            left_out[raw.topic, str(error)] += 1
            continue
        known.append((header_stamp_ns(message.header), _numbers(pose)))
    for topic, known in rows.items():
        kept = longest_increasing([stamp_ns for stamp_ns, _ in known])
        if len(kept) < len(known):
            left_out[topic, "the stamp is out of order, or that of another message"] += len(known) - len(kept)
        rows[topic] = [known[index] for index in kept]
    for (topic, reason), count in left_out.items():
        warn(f"{path}, {topic}: {count} messages are left out: {reason}")
    return {name: _trajectory(rows[topic]) for name, topic in topics.items() if rows[topic]}


def _numbers(pose: RosMessage) -> List[float]:
    p, q = pose.position, pose.orientation
    return [p.x, p.y, p.z, q.x, q.y, q.z, q.w]


def _trajectory(rows: List[Tuple[int, List[float]]]) -> Trajectory:
    stamps_ns, poses = zip(*rows)
    table = np.array(poses)
    quaternions = table[:, 3:] / np.linalg.norm(table[:, 3:], axis=1, keepdims=True)
    return Trajectory(np.array(stamps_ns, np.int64), table[:, :3], quaternions)
