# SPDX-License-Identifier: BSD-3-Clause
"""Publishes the camera's poses for dso_node."""

from typing import Optional

import numpy as np
import rospy
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from std_msgs.msg import Header

from ceiling_dso_ros.dso import OdometryStatus
from ceiling_dso_ros.msg import Keyframes, VisualOdometryStatus
from ceiling_dso_ros.ros.conversions import (
    odometry_message,
    pose_covariance,
    pose_from_matrix,
    unknown_covariance,
)
from ceiling_dso_ros.ros.paths import PathPublisher

PATH_SPACING = 0.01  # VO units: 1 % of the height of the ceiling


class OdometryPublisher:
    """The topics `visual_odometry/*` except those of the map, see `DsoServer`.

    Attributes:
        covariance_scale: factor on the covariance of the poses.
        path: the poses of the current segment.
    """

    def __init__(self) -> None:
        self.covariance_scale = 1.0
        self._odometry = rospy.Publisher("visual_odometry/odometry", Odometry, queue_size=10)
        self._pose = rospy.Publisher("visual_odometry/pose", PoseStamped, queue_size=10)
        self.path = PathPublisher("visual_odometry/path", spacing=PATH_SPACING)
        self._keyframes = rospy.Publisher("visual_odometry/keyframes", Keyframes, queue_size=50, latch=True)
        self._status = rospy.Publisher("visual_odometry/status", VisualOdometryStatus, queue_size=50, tcp_nodelay=True)
        self.reset()

    def reset(self) -> None:
        """Forget the poses so far."""
        self._segment = 0
        self._last_pose: Optional[np.ndarray] = None
        self.path.clear()

    def publish(self, header: Header, camera_frame_id: str, status: OdometryStatus) -> None:
        """Publish the pose of an image.

        Args:
            header: stamp of the image and the world frame.
            camera_frame_id: optical frame of the camera.
            status: result of the odometry for the image.
        """
        if status.T_world_camera is not None:
            self._last_pose = status.T_world_camera
            self._odometry.publish(odometry_message(header, camera_frame_id, self._last_pose, self._covariance(status)))
            self._publish_pose(PoseStamped(header, pose_from_matrix(self._last_pose)), status.segment)
        elif self._last_pose is not None:
            # The last pose with unknown covariance, because subscribers of odometry expect it to continue.
            self._odometry.publish(odometry_message(header, camera_frame_id, self._last_pose, unknown_covariance()))

    def publish_status(self, status: VisualOdometryStatus) -> None:
        """Publish the status of an image, and its keyframes alone, too."""
        if status.keyframes:
            self._keyframes.publish(Keyframes(status.header, status.keyframes))
        self._status.publish(status)

    def _publish_pose(self, pose: PoseStamped, segment: int) -> None:
        self._pose.publish(pose)
        if segment != self._segment:
            self._segment = segment
            self.path.clear()
        self.path.add(pose)

    def _covariance(self, status: OdometryStatus) -> np.ndarray:
        # Initialisation gives none for the pose that a segment begins with.
        if status.covariance is None or status.T_world_camera is None:
            return unknown_covariance()
        return self.covariance_scale * pose_covariance(status.covariance, status.T_world_camera)
