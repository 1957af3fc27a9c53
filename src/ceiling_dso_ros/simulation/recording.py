# SPDX-License-Identifier: BSD-3-Clause
"""A simulated drive as a recording: it can be played like any recording, without a bag."""

from functools import partial
from pathlib import Path
from typing import Iterator, Optional

import numpy as np

from ceiling_dso_ros.io.camera_models import CameraCalibration
from ceiling_dso_ros.io.output_camera import crop_camera
from ceiling_dso_ros.io.recording import (
    ListedImage,
    Recording,
    RobotDescription,
    SecondCamera,
    WheelSamples,
    WheelUnit,
)
from ceiling_dso_ros.io.trajectory import Trajectory
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.robot import UP, UP_RIGHT
from ceiling_dso_ros.simulation.sensors.measurements import CameraFrame, stamp_ns
from ceiling_dso_ros.simulation.simulation import Simulation


class SimulatedRecording(Recording):
    """A recording whose images are rendered when they are read; nothing is written to disk.

    Attributes:
        simulation: what is recorded.
    """

    def __init__(self, config: SimulationConfig = SimulationConfig()) -> None:
        """Plan the drive.

        Raises:
            ConfigError: a setting is out of range.
            EventError: a text in `events` does not describe an event.
        """
        self.simulation = Simulation(config)
        self.path = Path(f"simulated_{config.sequence}_{config.ceiling}_{config.seed}")
        camera = config.camera
        self.calibration = CameraCalibration(camera.lens, camera.pinhole)
        if camera.lens_error:
            told = camera.told_lens
            self.calibration = CameraCalibration(told, crop_camera(told, told.width, told.height))
        self.photometric = camera.photometric

    def __len__(self) -> int:
        return len(self.simulation.frame_times_s)

    def images(self) -> Iterator[ListedImage]:
        """See Recording."""
        for frame in self.simulation.frames():
            name = f"image at {frame.time_s:.3f} s"
            right = partial(_right_image, frame) if self.simulation.config.stereo else None
            yield ListedImage(frame.stamp_ns, frame.exposure_ms, name, partial(_upward_image, frame), right=right)

    @property
    def second_camera(self) -> Optional[SecondCamera]:
        """See Recording: the same camera, beside the first."""
        if not self.simulation.config.stereo:
            return None
        left, right = (self.simulation.robot.static_transforms()[name] for name in (UP, UP_RIGHT))
        return SecondCamera(self.calibration, self.photometric, np.linalg.inv(left) @ right)

    @property
    def wheels(self) -> WheelSamples:
        """See Recording; the counters wrap around."""
        encoders = self.simulation.encoders
        stamps_ns = np.array([stamp_ns(time_s) for time_s in encoders.time_s], dtype=np.int64)
        return WheelSamples(WheelUnit.TICKS, stamps_ns, encoders.counters)

    @property
    def robot(self) -> RobotDescription:
        """See Recording: the nominal dimensions."""
        return self.simulation.nominal

    @property
    def ground_truth_path(self) -> Optional[Path]:
        """See Recording: always None; the truth is in `camera_truth` and `base_truth`."""
        return None

    @property
    def camera_truth(self) -> Trajectory:
        """True poses of the upward camera's optical frame at the stamps of all images."""
        times = self.simulation.frame_times_s
        stamps_ns = [self.simulation.image_stamp_ns(time_s) for time_s in times]
        return Trajectory.from_matrices(stamps_ns, self.simulation.robot.T_world_camera(times))

    @property
    def base_truth(self) -> Trajectory:
        """True poses of base_link at the stamps of all wheel readings."""
        times = self.simulation.encoders.time_s
        stamps_ns = [stamp_ns(time_s) for time_s in times]
        return Trajectory.from_matrices(stamps_ns, self.simulation.robot.T_world_base(times))


def _right_image(frame: CameraFrame) -> np.ndarray:
    return frame.images[UP_RIGHT]


def _upward_image(frame: CameraFrame) -> np.ndarray:
    return frame.image
