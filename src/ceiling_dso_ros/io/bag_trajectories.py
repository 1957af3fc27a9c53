# SPDX-License-Identifier: BSD-3-Clause
"""Trajectories from recorded pose topics."""

from pathlib import Path
from typing import Callable, Dict, List, Tuple

import numpy as np

from ceiling_dso_ros.io.bag_reader import read_messages
from ceiling_dso_ros.io.errors import FrameError, InputError
from ceiling_dso_ros.io.ros_messages import RosMessage, header_stamp_ns
from ceiling_dso_ros.io.trajectory import Trajectory

POSE_OF: Dict[str, Callable[[RosMessage], RosMessage]] = {
    "nav_msgs/msg/Odometry": lambda message: message.pose.pose,
    "geometry_msgs/msg/PoseStamped": lambda message: message.pose,
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda message: message.pose.pose,
}


def read_trajectories(path: Path, topics: Dict[str, str]) -> Dict[str, Trajectory]:
    """Read the poses of some topics.

    Damaged messages, and stamps that are not later than the one before, are left out.

    Args:
        path: a ROS 1 bag.
        topics: name -> topic of nav_msgs/Odometry, geometry_msgs/PoseStamped or PoseWithCovarianceStamped.

    Returns:
        Name -> trajectory, of those topics that have poses.

    Raises:
        InputError: the bag cannot be read, or a topic has messages of another type.
    """
    rows: Dict[str, List[Tuple[int, List[float]]]] = {topic: [] for topic in topics.values()}
    for raw in read_messages(path, list(rows)):
        if raw.message_type not in POSE_OF:
            raise InputError(f"{path}, {raw.topic}: {raw.message_type} has no pose; {', '.join(POSE_OF)} have")
        try:
            message = raw.content()
        except FrameError:
            continue
        stamp_ns, pose = header_stamp_ns(message.header), _numbers(POSE_OF[raw.message_type](message))
        known = rows[raw.topic]
        if np.isfinite(pose).all() and (not known or stamp_ns > known[-1][0]):
            known.append((stamp_ns, pose))
    return {name: _trajectory(rows[topic]) for name, topic in topics.items() if rows[topic]}


def _numbers(pose: RosMessage) -> List[float]:
    p, q = pose.position, pose.orientation
    return [p.x, p.y, p.z, q.x, q.y, q.z, q.w]


def _trajectory(rows: List[Tuple[int, List[float]]]) -> Trajectory:
    stamps_ns, poses = zip(*rows)
    table = np.array(poses)
    return Trajectory(np.array(stamps_ns, np.int64), table[:, :3], table[:, 3:])
