# SPDX-License-Identifier: BSD-3-Clause
"""Poses and velocities of a robot on a floor as ROS messages."""

import numpy as np
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from std_msgs.msg import Header

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.ros.conversions import pose_from_matrix

FLOOR_VARIANCE = 1e-6  # of z, roll and pitch, determined by the floor: not zero, because subscribers invert it
IN_PLANE = (0, 1, 5)  # x, y, yaw
ALONG_DRIVE = (0, 5)  # forward speed and yaw rate


def spatial_covariance(covariance: np.ndarray, axes: tuple) -> np.ndarray:
    """(6, 6) of (x, y, z, roll, pitch, yaw) from the covariance of some of these axes."""
    full = FLOOR_VARIANCE * np.eye(6)
    full[np.ix_(axes, axes)] = covariance + 1e-9 * np.eye(len(axes))
    return full


def planar_odometry(
    header: Header,
    child_frame_id: str,
    pose: np.ndarray,
    covariance: np.ndarray,
    twist: np.ndarray,
    twist_covariance: np.ndarray,
) -> Odometry:
    """nav_msgs/Odometry.

    Args:
        header: stamp, and the frame of the pose.
        child_frame_id: the base, in whose axes the twist is.
        pose: (3,) x, y, yaw.
        covariance: (3, 3) of it.
        twist: (2,) forward speed and yaw rate.
        twist_covariance: (2, 2) of it.
    """
    message = Odometry(header=header, child_frame_id=child_frame_id)
    message.pose.pose = pose_from_matrix(planar.lift(pose))
    message.pose.covariance = spatial_covariance(covariance, IN_PLANE).ravel().tolist()
    message.twist.twist.linear.x, message.twist.twist.angular.z = twist.tolist()
    message.twist.covariance = spatial_covariance(twist_covariance, ALONG_DRIVE).ravel().tolist()
    return message


def planar_transform(header: Header, child_frame_id: str, pose: np.ndarray) -> TransformStamped:
    """geometry_msgs/TransformStamped of (3,) x, y, yaw of the child in the frame of the header."""
    transform = TransformStamped(header=header, child_frame_id=child_frame_id)
    body = pose_from_matrix(planar.lift(pose))
    transform.transform.translation.x = body.position.x
    transform.transform.translation.y = body.position.y
    transform.transform.rotation = body.orientation
    return transform
