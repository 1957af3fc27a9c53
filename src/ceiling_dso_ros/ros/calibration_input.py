# SPDX-License-Identifier: BSD-3-Clause
"""The camera's calibration for dso_node, from a file or from camera_info."""

import threading
from pathlib import Path
from typing import Any, Optional, Tuple

import rospy
from sensor_msgs.msg import CameraInfo

from ceiling_dso_ros.io.camera_models import CameraCalibration, calibration_from_camera_info, read_camera_file
from ceiling_dso_ros.io.errors import InputError

WARNING_PERIOD_S = 5.0


class CalibrationInput:
    """The calibration in a file, or without a file the newest one from camera_info.

    Attributes:
        complaint: why the last camera_info was ignored; empty when it was not.
    """

    def __init__(self, calibration_file: Optional[Path], rectified: bool) -> None:
        """Read the file, or subscribe to camera_info if there is none.

        Args:
            calibration_file: camera.txt in the TUM-mono layout.
            rectified: images are rectified: P of camera_info describes them, not K and D.

        Raises:
            InputError: the file cannot be read or is not a calibration.
        """
        self.complaint = ""
        self._rectified = rectified
        self._fields: Tuple[Any, ...] = ()  # of camera_info as last received
        self._newest: Optional[CameraCalibration] = None
        self._known = threading.Event()
        if calibration_file is None:
            rospy.Subscriber("camera_info", CameraInfo, self._on_camera_info, queue_size=1)
        else:
            self._newest = read_camera_file(calibration_file)
            self._known.set()

    def newest(self, timeout_s: float) -> Optional[CameraCalibration]:
        """The newest calibration; waits for the first one, None if it does not arrive in time."""
        self._known.wait(timeout_s)
        return self._newest

    def _on_camera_info(self, message: CameraInfo) -> None:
        fields = (message.width, message.height, message.distortion_model, message.D, message.K, message.P)
        if fields == self._fields:
            return
        self._fields = fields
        try:
            topic = rospy.resolve_name("camera_info")
            self._newest = calibration_from_camera_info(*fields, self._rectified, source=topic)
            self.complaint = ""
            self._known.set()
        except InputError as error:
            self.complaint = f"ignored: {error}"
            rospy.logwarn_throttle(WARNING_PERIOD_S, self.complaint)
