# SPDX-License-Identifier: BSD-3-Clause
"""Preprocessing and odometry for the images of one camera, for offline runs and dso_node."""

import time
from dataclasses import replace
from typing import NamedTuple, Optional, Tuple

import numpy as np

from ceiling_dso_ros.dso import CameraMotion, DirectOdometry, OdometryConfig, OdometryStatus
from ceiling_dso_ros.dso.compute.schedulers import SequentialScheduler
from ceiling_dso_ros.io.preprocessing import ImagePreprocessor
from ceiling_dso_ros.io.recording import Recording
from ceiling_dso_ros.playback.trajectory_recorder import TrajectoryRecorder


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
    """

    def __init__(self, preprocess: ImagePreprocessor, odometry: DirectOdometry, keep_trajectory: bool = True) -> None:
        """Begin.

        Args:
            preprocess: converts raw images for the odometry.
            odometry: before its first image.
            keep_trajectory: remember the poses, 272 bytes an image.
        """
        self.preprocess = preprocess
        self._keep = keep_trajectory
        self.odometry = odometry
        self.last: Optional[OdometryStatus]
        self._forget()

    @classmethod
    def of(
        cls, recording: Recording, config: OdometryConfig = OdometryConfig(),
        scheduler: Optional[SequentialScheduler] = None, size: Optional[Tuple[int, int]] = None,
    ) -> "VisualRun":  # fmt: skip
        """A run over the images of a recording, scaled to (width, height) where a size is given.

        Raises:
            InputError: the images cannot be scaled to that size.
            ConfigError: images of that size cannot be tracked, or a setting is out of range.
        """
        preprocess = ImagePreprocessor(recording.calibration, recording.photometric, size)
        return cls(preprocess, DirectOdometry(preprocess.camera, config, scheduler))

    def track(
        self, image: np.ndarray, stamp_ns: int, exposure_ms: Optional[float],
        prediction: Optional[CameraMotion] = None,
    ) -> TrackedImage:  # fmt: skip
        """Process one image.

        Args:
            image: (height, width) uint8 or uint16, as it comes from the camera.
            stamp_ns: its stamp, nanoseconds.
            exposure_ms: None when unknown.
            prediction: motion of the camera since the last image, predicted by other sensors; None if there is no
                prediction.
        """
        start_s = time.perf_counter()
        preprocessed = self.preprocess(image)
        preprocessed_s = time.perf_counter()
        status = self.odometry.track(preprocessed, stamp_ns, exposure_ms, prediction)
        end_s = time.perf_counter()
        timing_ms = {"undistort": 1e3 * (preprocessed_s - start_s), **status.timing_ms}
        self.last = replace(status, timing_ms=timing_ms)
        if self._keep:
            self.trajectories.add(status)
        return TrackedImage(self.last, preprocessed, 1e3 * (end_s - start_s))

    def restart(self) -> None:
        """Forget everything: the next image starts segment 0."""
        self.odometry.reset()
        self._forget()

    def _forget(self) -> None:
        self.trajectories = TrajectoryRecorder()
        self.last = None
