# SPDX-License-Identifier: BSD-3-Clause
"""Preprocessing and odometry for the images of one camera, for offline runs and dso_node."""

import time
import zlib
from collections import deque
from dataclasses import replace
from typing import Callable, Deque, NamedTuple, Optional, Tuple

import numpy as np

from ceiling_dso_ros.dso import CameraMotion, DirectOdometry, OdometryConfig, OdometryStatus
from ceiling_dso_ros.dso.compute.schedulers import SequentialScheduler
from ceiling_dso_ros.io.camera_models import CameraCalibration
from ceiling_dso_ros.io.grey_range import GreyRange
from ceiling_dso_ros.io.photometric import PhotometricCalibration
from ceiling_dso_ros.io.preprocessing import ImagePreprocessor
from ceiling_dso_ros.io.recording import Recording, SecondCamera
from ceiling_dso_ros.io.warning_log import ignore_warning
from ceiling_dso_ros.playback.frame_regulation import FrameRegulation
from ceiling_dso_ros.playback.right_images import RawRight, RightImages
from ceiling_dso_ros.playback.trackable_size import trackable_size
from ceiling_dso_ros.playback.trajectory_recorder import TrajectoryRecorder

REMEMBERED_IMAGES = 8  # as many as a driver has buffers, which it may send again in turns
CHECKED_ROWS = 4  # one of so many: the noise of an image is in all of them


class TrackedImage(NamedTuple):
    """An image with its result.

    Attributes:
        status: result of the odometry; its timing includes the preprocessing as `undistort`.
        image: (height, width) float32, the input of the odometry.
        total_ms: milliseconds of preprocessing and odometry.
    """

    status: OdometryStatus
    image: np.ndarray
    total_ms: float


class VisualRun:
    """Tracks raw images and keeps the trajectory.

    Attributes:
        preprocess: converts raw images for the odometry.
        odometry: the odometry.
        trajectories: the poses so far.
        last: status of the last image; None before the first.
        regulation: leaves images out; None to use all.
    """

    def __init__(
        self,
        preprocess: ImagePreprocessor,
        odometry: DirectOdometry,
        keep_trajectory: bool = True,
        right: Optional[RightImages] = None,
    ) -> None:
        """Begin.

        Args:
            preprocess: converts raw images for the odometry.
            odometry: before its first image.
            keep_trajectory: remember the poses, 272 bytes an image.
            right: converts the images of the second camera; None without one.
        """
        self.preprocess = preprocess
        self._right = right
        self._keep = keep_trajectory
        self.odometry = odometry
        self.regulation: Optional[FrameRegulation] = None
        self.last: Optional[OdometryStatus]
        self._checksums: Deque[int]
        self._forget()

    @classmethod
    def of(
        cls, recording: Recording, config: OdometryConfig = OdometryConfig(),
        scheduler: Optional[SequentialScheduler] = None, size: Optional[Tuple[int, int]] = None,
        bits: int = 0, tell: Callable[[str], None] = ignore_warning,
    ) -> "VisualRun":  # fmt: skip
        """A run over the images of a recording; see `of_camera`."""
        images, second = (recording.calibration, recording.photometric), recording.second_camera
        return cls.of_camera(
            *images, config=config, scheduler=scheduler, size=size, bits=bits, tell=tell, second=second
        )

    @classmethod
    def of_camera(
        cls, calibration: CameraCalibration, photometric: PhotometricCalibration = PhotometricCalibration.linear(),
        *, config: OdometryConfig = OdometryConfig(), scheduler: Optional[SequentialScheduler] = None,
        size: Optional[Tuple[int, int]] = None, bits: int = 0, tell: Callable[[str], None] = ignore_warning,
        keep_trajectory: bool = True, second: Optional[SecondCamera] = None,
    ) -> "VisualRun":  # fmt: skip
        """A run over the images of a camera.

        Args:
            calibration: of the raw images.
            photometric: of the raw images.
            config: settings of the odometry.
            scheduler: of the mapping.
            size: (width, height) to scale the images to. Without one, images that cannot be tracked in their own size
                are cropped.
            bits: bit depth of images with more than 8 bits, 0 to find it from them.
            tell: is told in one line that images are cropped, and the bit depth that was found.
            keep_trajectory: see above.
            second: the camera beside it; None without one.

        Raises:
            InputError: the images cannot be scaled to that size.
            ConfigError: images of that size cannot be tracked, or a setting is out of range.
        """
        camera, crop = calibration.camera, None
        if size is None:
            own = camera.width, camera.height
            crop = trackable_size(*own)
            if crop == own:
                crop = None
            else:
                tell(
                    f"images of {camera.width}x{camera.height} pixels cannot be halved often enough to be tracked: "
                    f"they are cropped to {crop[0]}x{crop[1]}"
                )
        preprocess = ImagePreprocessor(calibration, photometric, size, crop, GreyRange(bits, tell))
        right = None if second is None else RightImages(second, size, crop, bits)
        rig = None if right is None else right.rig
        return cls(preprocess, DirectOdometry(preprocess.camera, config, scheduler, rig), keep_trajectory, right)

    @property
    def has_second_camera(self) -> bool:
        """Whether keyframes can measure the scale."""
        return self._right is not None

    def regulate(self, on: bool) -> None:
        """Let images be left out while hardly anything moves, from the next one on, or use all."""
        if on != (self.regulation is not None):
            self.regulation = FrameRegulation(self.preprocess.camera) if on else None

    def leaves_out(self, stamp_ns: int, prediction: Optional[CameraMotion] = None) -> bool:
        """Whether not to track the next image, judged before any work on it.

        Args:
            stamp_ns: its stamp, nanoseconds.
            prediction: as for `track`.
        """
        if self.regulation is None:
            return False
        return self.regulation.leaves_out(stamp_ns, self.odometry.expect(stamp_ns, prediction))

    def track(
        self, image: np.ndarray, stamp_ns: int, exposure_ms: Optional[float],
        prediction: Optional[CameraMotion] = None, right: Optional[RawRight] = None,
    ) -> TrackedImage:  # fmt: skip
        """Process one image. One that repeats one of the last, as of a driver that has stopped, has no pose.

        Args:
            image: (height, width) uint8, uint16 or float32, as it comes from the camera.
            stamp_ns: its stamp, nanoseconds.
            exposure_ms: None when unknown.
            prediction: motion of the camera since the image that the last status asks for, predicted by other sensors;
                None if there is no prediction.
            right: gives the raw image of the second camera of the same moment; None if there is none.
        """
        start_s = time.perf_counter()
        preprocessed = self.preprocess(image)
        preprocessed_s = time.perf_counter()
        if self._repeats(image):
            status = self.odometry.skip(stamp_ns, "the camera repeats its last images")
        else:
            second = None if self._right is None or right is None else self._right.later(right)
            status = self.odometry.track(preprocessed, stamp_ns, exposure_ms, prediction, second)
        end_s = time.perf_counter()
        timing_ms = {"undistort": 1e3 * (preprocessed_s - start_s), **status.timing_ms}
        self.last = status
        if self.regulation is not None:
            self.regulation.use(stamp_ns, None if status.T_world_camera is None else status.rmse)
        if self._keep:
            self.trajectories.add(status)
        return TrackedImage(replace(status, timing_ms=timing_ms), preprocessed, 1e3 * (end_s - start_s))

    def restart(self) -> None:
        """Forget everything: the next image starts segment 0."""
        self.odometry.reset()
        self._forget()

    def _forget(self) -> None:
        self.trajectories = TrajectoryRecorder()
        self.last = None
        self._checksums = deque(maxlen=REMEMBERED_IMAGES)
        if self.regulation is not None:
            self.regulation.restart()

    def _repeats(self, image: np.ndarray) -> bool:
        """Whether an image is the very same as one of the last, which only one without noise can be: black or white."""
        checksum = zlib.crc32(image[::CHECKED_ROWS].tobytes())
        if checksum in self._checksums:
            return bool(image.min() != image.max())
        self._checksums.append(checksum)
        return False
