# SPDX-License-Identifier: BSD-3-Clause
"""A rendered drive in memory, with the truth: what the sensors of the robot would say, in the order of time."""

import heapq
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Iterator, List, Optional, Tuple, Union

import numpy as np

from ceiling_dso_ros.experiments.rendered_drives import RenderedDrive, RenderedDrives
from ceiling_dso_ros.io.lens_models import LensCamera
from ceiling_dso_ros.simulation.bag import WHEEL_JOINTS
from ceiling_dso_ros.simulation.camera import CameraModel
from ceiling_dso_ros.simulation.config import SimulationConfig

CAMERA = CameraModel(width=424, height=240, fps=15.0)
LONGEST_S = 40.0


@dataclass(frozen=True)
class Picture:
    """An image as the camera's driver sends it.

    Attributes:
        time_s: since the drive began.
        pixels: (H, W) uint8.
        exposure_ms: None: no exposure is published.
        encoding: as the message says it.
        later_ns: what is added to the stamp.
        missing_bytes: how much of the data is left out.
    """

    time_s: float
    pixels: np.ndarray
    exposure_ms: Optional[float]
    encoding: str = "mono8"
    later_ns: int = 0
    missing_bytes: int = 0

    def showing(self, pixels: np.ndarray) -> "Picture":
        """The same with other pixels."""
        return replace(self, pixels=np.ascontiguousarray(np.clip(pixels, 0, 255).astype(np.uint8)))


@dataclass(frozen=True)
class Angles:
    """Angles of the wheels as their driver sends them.

    Attributes:
        time_s: since the drive began.
        radians: (2,) left and right.
        names: of the joints.
        later_ns: what is added to the stamp.
    """

    time_s: float
    radians: np.ndarray
    names: Tuple[str, ...] = WHEEL_JOINTS
    later_ns: int = 0


Sample = Union[Picture, Angles]


class Drive:
    """All samples of a drive and where the robot was.

    Attributes:
        lens: of the camera.
        T_base_camera: (4, 4) as the robot's file has it.
    """

    def __init__(self, rendered: RenderedDrive) -> None:
        simulation = rendered.simulated.simulation
        self.lens: LensCamera = simulation.config.camera.lens
        self.T_base_camera = simulation.nominal.T_base_camera
        # The images come in the order of their times; their stamps are those of the simulation.
        images = zip(simulation.frame_times_s, rendered.recording.images())
        self._pictures = [Picture(float(t), image.decode(), image.exposure_ms) for t, image in images]
        encoders = simulation.encoders
        angles = encoders.angles_rad(simulation.nominal.ticks_per_turn)
        self._angles = [Angles(float(t), radians) for t, radians in zip(encoders.time_s, angles)]
        T = simulation.robot.T_world_base(encoders.time_s)
        yaw = np.unwrap(np.arctan2(T[:, 1, 0].copy(), T[:, 0, 0].copy()))
        self._time_s, self._poses = encoders.time_s, np.column_stack([T[:, :2, 3], yaw])

    def __iter__(self) -> Iterator[Sample]:
        streams: List[List[Sample]] = [[*self._angles], [*self._pictures]]
        return iter(heapq.merge(*streams, key=lambda sample: sample.time_s))

    def pose(self, time_s: float) -> np.ndarray:
        """True x, y, yaw of base_link, (3,)."""
        return np.array([np.interp(time_s, self._time_s, column) for column in self._poses.T])


def whole_lap(folder: Path) -> RenderedDrive:
    """A lap that begins and ends at rest; rendered once."""
    return RenderedDrives(folder).drive(SimulationConfig("loops", "factory", 1, camera=CAMERA))


def rendered(folder: Path, *events: str) -> RenderedDrive:
    """The drive of the faults, with events of the simulator; rendered once."""
    config = SimulationConfig("loops", "factory", 0, duration_s=LONGEST_S, camera=CAMERA, events=events)
    return RenderedDrives(folder).drive(config)
