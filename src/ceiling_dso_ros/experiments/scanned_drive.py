# SPDX-License-Identifier: BSD-3-Clause
"""A simulated drive as its LiDAR and its wheels see it, without images, and a reference judged by the truth."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Optional

import numpy as np

from ceiling_dso_ros.io.laser_scans import LaserScans, ScanCollector, ScanGeometry
from ceiling_dso_ros.io.trajectory import Trajectory
from ceiling_dso_ros.io.warning_log import ignore_warning
from ceiling_dso_ros.lidar.reference import Reference
from ceiling_dso_ros.lidar.scans.poses import matrices
from ceiling_dso_ros.lidar.scans.wheel_motion import WheelMotions, wheel_motions
from ceiling_dso_ros.lidar.uncertainty import aligned_errors, normalised_errors
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.obstacles import Obstacles
from ceiling_dso_ros.simulation.recording import SimulatedRecording
from ceiling_dso_ros.simulation.robot import T_BASE_LASER
from ceiling_dso_ros.simulation.sensors.laser import SCAN_RANGE_M, LaserScanner
from ceiling_dso_ros.simulation.sensors.measurements import START_NS


class ScannedDrive:
    """A simulated drive.

    Attributes:
        recording: all of it.
        scans: of the LiDAR, with its true mount.
    """

    def __init__(self, config: SimulationConfig, obstacles: Optional[Obstacles] = None) -> None:
        """Drive and scan.

        Args:
            config: of the drive.
            obstacles: what the scanner sees, instead of the hall.

        Raises:
            ConfigError: a setting is out of range.
        """
        self.recording = SimulatedRecording(config)
        simulation, laser = self.recording.simulation, config.laser
        readings = simulation.scans()
        if obstacles is not None:
            readings = simulation.scans_of(LaserScanner(obstacles, simulation.rng("scan"), laser))
        collector = ScanCollector(f"{self.recording.path}", ignore_warning)
        angles = laser.angles
        geometry = ScanGeometry(float(angles[0]), float(angles[1] - angles[0]), laser.time_increment_s)
        for reading in readings:
            collector.add(reading.stamp_ns, reading.ranges_m, geometry, np.array(SCAN_RANGE_M))
        self.scans: LaserScans = collector.scans(T_BASE_LASER)

    @cached_property
    def wheels(self) -> WheelMotions:
        """Dead reckoning with the nominal dimensions."""
        motions = wheel_motions(self.recording.wheels, self.recording.robot, ignore_warning)
        if motions is None:
            raise RuntimeError("simulated wheels can be used")
        return motions

    @cached_property
    def truth(self) -> np.ndarray:
        """(N, 3) true poses of the base at the stamps of the scans."""
        times_s = (self.scans.stamps_ns - START_NS) / 1e9
        return self.recording.simulation.robot.motion.poses(times_s)

    @property
    def true_trajectory(self) -> Trajectory:
        """The same."""
        return Trajectory.from_matrices(self.scans.stamps_ns, matrices(self.truth))


@dataclass(frozen=True)
class ReferenceErrors:
    """Errors of a reference after an alignment of its positions: root mean squares, and the mean NEES over three."""

    position_m: float
    yaw_deg: float
    nees: float

    @staticmethod
    def of(reference: Reference, truth: np.ndarray) -> "ReferenceErrors":
        """Against (N, 3) true poses at the stamps of the scans."""
        errors = aligned_errors(reference.path.poses, truth)
        squares = np.mean(errors**2, axis=0)
        nees = float(np.mean(normalised_errors(errors, reference.covariances)))
        return ReferenceErrors(float(np.sqrt(squares[0] + squares[1])), float(np.degrees(np.sqrt(squares[2]))), nees)


def with_ranges(scans: LaserScans, ranges_m: np.ndarray) -> LaserScans:
    """The same scans with other ranges."""
    return replace(scans, ranges_m=np.asarray(ranges_m, np.float32))
