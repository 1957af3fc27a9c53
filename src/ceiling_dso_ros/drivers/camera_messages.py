# SPDX-License-Identifier: BSD-3-Clause
"""The messages of a camera, for topics or for a bag."""

from typing import Optional

import numpy as np

from ceiling_dso_ros.drivers.inertial import InertialSample
from ceiling_dso_ros.drivers.reports import CameraDescription, Lens
from ceiling_dso_ros.drivers.stamping import StampedImages
from ceiling_dso_ros.io.message_writer import MessageWriter

LEFT_TOPICS, RIGHT_TOPICS, IMU_TOPIC = "/camera/up", "/camera/up_right", "/camera/imu"
OPTICAL = "_optical_frame"


class CameraMessages:
    """Writes camera_info, exposure and image for each of the images, static transforms, and inertial samples.

    Args:
        writer: to write to.
        camera_frame: optical frame of the left images; those of the right ones and of the inertial unit are named
            by it.
    """

    def __init__(self, writer: MessageWriter, camera_frame: str) -> None:
        self._writer = writer
        stem = camera_frame[: -len(OPTICAL)] if camera_frame.endswith(OPTICAL) else camera_frame
        self.left_frame = camera_frame
        self.right_frame, self.imu_frame = f"{stem}_right{OPTICAL}", f"{stem}_imu{OPTICAL}"
        self._camera: Optional[CameraDescription] = None

    def write_camera(self, stamp_ns: int, camera: CameraDescription) -> None:
        """Write where its parts are; the images that follow are those of this camera.

        Raises:
            OutputError: a bag cannot be written.
        """
        self._camera = camera
        frames = ((self.right_frame, camera.T_left_right), (self.imu_frame, camera.T_left_imu))
        transforms = [(self.left_frame, child, T) for child, T in frames if T is not None]
        if transforms:
            self._writer.tf_static(stamp_ns, transforms)

    def write_images(self, stamped: StampedImages) -> None:
        """Write the images of one moment.

        Raises:
            OutputError: a bag cannot be written.
        """
        camera = self._camera
        if camera is None:
            return
        baseline_m = 0.0 if camera.T_left_right is None else float(camera.T_left_right[0, 3])
        sides = (
            (LEFT_TOPICS, self.left_frame, camera.left, 0.0),
            (RIGHT_TOPICS, self.right_frame, camera.right, baseline_m),
        )
        for image, (topics, frame, lens, baseline) in zip(stamped.images, sides):
            if lens is not None:
                self._write_image(stamped, image, topics, frame, lens, baseline)

    def _write_image(
        self, stamped: StampedImages, image: np.ndarray, topics: str, frame: str, lens: Lens, baseline_m: float
    ) -> None:
        stamp_ns, size = stamped.stamp_ns, (image.shape[1], image.shape[0])
        self._writer.camera_info(
            f"{topics}/camera_info", stamp_ns, frame, size, lens.K, lens.distortion, baseline_m=baseline_m
        )
        # 0 means unknown: those who track the image need not wait for it.
        self._writer.exposure(f"{topics}/exposure", stamp_ns, frame, stamped.exposure_ms or 0.0)
        self._writer.image(f"{topics}/image_raw", stamp_ns, frame, image)

    def write_inertial(self, stamp_ns: int, sample: InertialSample) -> None:
        """Write an angular rate and an acceleration.

        Raises:
            OutputError: a bag cannot be written.
        """
        self._writer.imu(IMU_TOPIC, stamp_ns, self.imu_frame, sample.rate, sample.force)
