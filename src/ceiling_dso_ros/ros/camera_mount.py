# SPDX-License-Identifier: BSD-3-Clause
"""Pose of the camera on the robot: from robot.yaml, else from tf."""

from typing import Optional

import numpy as np
import rospy
import tf2_ros

from ceiling_dso_ros.io.errors import one_line
from ceiling_dso_ros.ros.conversions import matrix_from_transform

LOOKUP_PERIOD_S = 0.2


class CameraMount:
    """Looks up `base_link -> camera` in tf until it is known, then stops listening.

    Attributes:
        complaint: why the pose is not known, in words; empty when it is known.
    """

    def __init__(self, base_frame: str, camera_frame: str, T_base_camera: Optional[np.ndarray]) -> None:
        self._base_frame, self._camera_frame = base_frame, camera_frame.lstrip("/")
        self._T_base_camera = T_base_camera
        self._asked_s = -np.inf
        self.complaint = "" if T_base_camera is not None else "the camera's frame is not known yet"
        self._listener: Optional[tf2_ros.TransformListener] = None
        if T_base_camera is None:
            self._buffer = tf2_ros.Buffer()
            self._listener = tf2_ros.TransformListener(self._buffer)

    def name_frame(self, camera_frame: str) -> None:
        """Set the camera's frame, if the parameters do not."""
        self._camera_frame = self._camera_frame or camera_frame.lstrip("/")

    def find(self) -> Optional[np.ndarray]:
        """T_base_camera (4, 4), None while it is not known."""
        now_s = rospy.get_time()
        if self._listener is not None and self._camera_frame and abs(now_s - self._asked_s) >= LOOKUP_PERIOD_S:
            self._asked_s = now_s
            self._look_up(self._listener)
        return self._T_base_camera

    def _look_up(self, listener: tf2_ros.TransformListener) -> None:
        try:
            found = self._buffer.lookup_transform(self._base_frame, self._camera_frame, rospy.Time(0))
            self._T_base_camera = matrix_from_transform(found.transform)
        except (tf2_ros.TransformException, ValueError) as error:
            self.complaint = one_line(f"tf has no {self._base_frame} -> {self._camera_frame}: {error}")
            return
        self.complaint = ""
        listener.unregister()
        self._listener = None
