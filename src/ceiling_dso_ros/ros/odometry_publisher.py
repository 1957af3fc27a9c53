"""Publishes what the visual odometry says of each image."""

import time
from typing import List, Optional

import numpy as np
import rospy
from dynamic_reconfigure.server import Server
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry, Path
from std_msgs.msg import Header

from ceiling_dso_ros.cfg import DsoConfig
from ceiling_dso_ros.dso import OdometryStatus
from ceiling_dso_ros.msg import Keyframes, VisualOdometryStatus
from ceiling_dso_ros.ros.conversions import (
    keyframes_message,
    odometry_message,
    pose_covariance,
    pose_from_matrix,
    unknown_covariance,
)


class OdometryPublisher:
    """The topics `visual_odometry/*`, see `DsoServer`."""

    def __init__(self) -> None:
        self._odometry = rospy.Publisher("visual_odometry/odometry", Odometry, queue_size=10)
        self._pose = rospy.Publisher("visual_odometry/pose", PoseStamped, queue_size=10)
        self._path = rospy.Publisher("visual_odometry/path", Path, queue_size=1)
        self._keyframes = rospy.Publisher("visual_odometry/keyframes", Keyframes, queue_size=10)
        self._status = rospy.Publisher("visual_odometry/status", VisualOdometryStatus, queue_size=10)
        self.reset()
        self._reconfigure_server = Server(DsoConfig, self._reconfigure)

    def reset(self) -> None:
        """Forget the poses so far."""
        self._segment = 0
        self._last_pose: Optional[np.ndarray] = None
        self._poses: List[PoseStamped] = []
        self._path_time_s = -np.inf

    def publish(self, header: Header, camera_frame_id: str, status: OdometryStatus) -> None:
        """Publish keyframes and poses of an image.

        Args:
            header: stamp of the image and the world frame.
            camera_frame_id: optical frame of the camera.
            status: what the odometry says of the image.
        """
        if status.keyframes:
            self._keyframes.publish(keyframes_message(header, status.keyframes))
        if status.T_world_camera is not None:
            self._last_pose = status.T_world_camera
            self._odometry.publish(odometry_message(header, camera_frame_id, self._last_pose, self._covariance(status)))
            self._publish_pose(PoseStamped(header, pose_from_matrix(self._last_pose)), status.segment)
        elif self._last_pose is not None:
            # The last pose, of which nothing is known any more: those who take odometry expect it to go on.
            self._odometry.publish(odometry_message(header, camera_frame_id, self._last_pose, unknown_covariance()))

    def publish_status(self, status: VisualOdometryStatus) -> None:
        """Publish the status of an image."""
        self._status.publish(status)

    def _publish_pose(self, pose: PoseStamped, segment: int) -> None:
        self._pose.publish(pose)
        if segment != self._segment:
            self._segment = segment
            self._poses.clear()
        self._poses.append(pose)
        del self._poses[: -self._settings.path_length]
        now_s = time.monotonic()
        # The whole path is sent each time: only for those who listen, and not with every image.
        if self._path.get_num_connections() > 0 and now_s >= self._path_time_s + self._settings.path_period:
            self._path.publish(Path(pose.header, self._poses))
            self._path_time_s = now_s

    def _covariance(self, status: OdometryStatus) -> np.ndarray:
        if status.covariance is None:  # the pose that a segment begins with: initialisation gives none
            return unknown_covariance()
        return self._settings.covariance_scale * pose_covariance(status.covariance, status.T_world_camera)

    def _reconfigure(self, settings: DsoConfig, _level: int) -> DsoConfig:
        self._settings = settings
        return settings
