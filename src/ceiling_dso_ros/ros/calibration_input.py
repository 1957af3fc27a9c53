# SPDX-License-Identifier: BSD-3-Clause
"""The camera's calibration for dso_node, from a file or from camera_info."""

import threading
from pathlib import Path
from typing import Any, Dict, Optional, Tuple

import rospy
from sensor_msgs.msg import CameraInfo

from ceiling_dso_ros.io.camera_info import (
    calibration_from_camera_info,
    camera_info_fields,
    distorted_though_rectified,
)
from ceiling_dso_ros.io.camera_models import CameraCalibration, read_camera_file
from ceiling_dso_ros.io.errors import InputError, one_line
from ceiling_dso_ros.ros.waiting import wait_until

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
        self._lock = threading.Lock()  # between the subscriber and the worker
        self._received = threading.Event()
        self._fields: Dict[str, Any] = {}  # of camera_info as last received
        self._image_size: Optional[Tuple[int, int]] = None
        self._newest: Optional[CameraCalibration] = None
        self._of_file: Optional[CameraCalibration] = None
        if calibration_file is None:
            rospy.Subscriber("camera_info", CameraInfo, self._on_camera_info, queue_size=1)
        else:
            self._of_file = read_camera_file(calibration_file)

    def newest(self, timeout_s: float, image_size: Tuple[int, int]) -> Optional[CameraCalibration]:
        """The newest calibration for images of (width, height); waits for a camera_info if none has come yet.

        Returns:
            None if there is none; equal calibrations mean an unchanged camera.
        """
        if self._of_file is not None:
            return self._of_file
        wait_until(self._received.is_set, timeout_s)
        with self._lock:
            if image_size != self._image_size:
                self._image_size = image_size
                self._read()
        return self._newest

    def _on_camera_info(self, message: CameraInfo) -> None:
        fields = camera_info_fields(message)
        if fields == self._fields:
            return
        with self._lock:
            self._fields = fields
            self._read()
        self._received.set()
        doubt = distorted_though_rectified(rospy.resolve_name("image"), message.D)
        if doubt is not None and not self._rectified:
            rospy.logwarn(doubt)

    def _read(self) -> None:
        """Take the newest camera_info, unless it is wrong, or for other images: then the one before remains."""
        if not self._fields:
            return
        topic = rospy.resolve_name("camera_info")
        try:
            read = calibration_from_camera_info(
                **self._fields, rectified=self._rectified, image_size=self._image_size, source=topic
            )
            if self._newest is not None and read.image_size != self._image_size == self._newest.image_size:
                sizes = "{}x{}, not {}x{}".format(*read.image_size, *self._image_size)
                raise InputError(f"{topic}: it is for images of {sizes}")
            self._newest, self.complaint = read, ""
        except InputError as error:
            self.complaint = one_line(f"ignored: {error}")
            rospy.logwarn_throttle(WARNING_PERIOD_S, self.complaint)
