# SPDX-License-Identifier: BSD-3-Clause
"""A second camera, under roofs that are drawn at random, as are cameras and wheels: metres without wheels, and wheels.

The cameras' geometry is exact in the simulation. So the odometry is told that it is, but for the error that finding
points in the images may make, `OWN_BIAS_PX`, which the tests of the kernels keep to.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Dict, Iterator, List, Sequence, Tuple

import numpy as np
from support.table import Row
from tqdm import tqdm

from ceiling_dso_ros.dso import OdometryConfig
from ceiling_dso_ros.dso.config import RigConfig
from ceiling_dso_ros.dso.status import KeyframeEstimate
from ceiling_dso_ros.evaluation.alignment import AlignmentKind, align
from ceiling_dso_ros.evaluation.association import interpolate_poses
from ceiling_dso_ros.experiments.kept_runs import OdometryRun, Statuses
from ceiling_dso_ros.experiments.tracked_drives import TrackedDrives
from ceiling_dso_ros.fusion.calibration import MEAN_RADIUS, CalibratedValue, calibrate
from ceiling_dso_ros.fusion.calibration_data import camera_poses
from ceiling_dso_ros.fusion.config import WheelConfig
from ceiling_dso_ros.fusion.metric_scale import SegmentScale, metric_positions, segment_scales
from ceiling_dso_ros.fusion.wheel import WheelOdometry
from ceiling_dso_ros.playback.fusion_playback import robot_model
from ceiling_dso_ros.playback.trajectory_recorder import TrajectoryRecorder
from ceiling_dso_ros.playback.wheel_playback import wheel_steps
from ceiling_dso_ros.simulation.drawn import draw_config
from ceiling_dso_ros.simulation.recording import SimulatedRecording

FIRST_ROOF, ROOFS = 100, 20  # seeds for judging
WAY_M = 5.0
HEIGHTS_M = (3.0, 6.0)  # of the whole roof above the camera, at which the limits hold
SCALE_PERCENT, RADIUS_PERCENT = 0.3, 0.2
WRONG_BASELINE = 0.003
OWN_BIAS_PX = 0.006
NEES = (1.0 / 3.0, 3.0)
EXACT = OdometryConfig(rig=RigConfig(baseline_sigma=0.0, disparity_sigma=OWN_BIAS_PX))


@dataclass(frozen=True)
class StereoDrive:
    """One drive with the odometry's results."""

    seed: int
    simulated: SimulatedRecording
    statuses: Statuses

    @cached_property
    def height_m(self) -> Tuple[float, float]:
        """Of the lowest and the highest line of the roof above the camera."""
        simulation = self.simulated.simulation
        low, high = simulation.hall.description["height_m"]
        camera = float(simulation.nominal.T_base_camera[2, 3])
        return low - camera, high - camera

    @property
    def is_judged(self) -> bool:
        """Whether the limits hold at its height."""
        return HEIGHTS_M[0] <= self.height_m[0] and self.height_m[1] <= HEIGHTS_M[1]

    @cached_property
    def recorder(self) -> TrajectoryRecorder:
        """The poses."""
        recorder = TrajectoryRecorder()
        for status in self.statuses:
            recorder.add(status)
        return recorder

    def scales(self, log_error: float = 0.0) -> Dict[int, SegmentScale]:
        """Of the segments, by a baseline whose logarithm is wrong, which makes all scales wrong by that."""
        rig = EXACT.rig if not log_error else RigConfig(WRONG_BASELINE, OWN_BIAS_PX)
        return segment_scales(_told_by(rig, keyframe, log_error) for keyframe in self.recorder.estimates.values())

    def scale_error(self) -> Tuple[float, float]:
        """Of the first WAY_M metres with a scale: logarithm of the length over the true one, and its sigma."""
        scales = self.scales()
        if not scales:
            return np.nan, np.nan
        stamps_ns, segments, T = self.recorder.final_matrices()
        positions = metric_positions(stamps_ns, segments, T[:, :3, 3], scales)
        known = np.isfinite(positions).all(axis=1)
        truth = self.simulated.camera_truth
        true = interpolate_poses(truth.stamps_ns, truth.matrices(), stamps_ns[known])[:, :3, 3]
        way_m = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(true, axis=0), axis=1)))
        first = way_m <= WAY_M
        found = align(positions[known][first], true[first], AlignmentKind.SIM3)
        scale = scales[min(scales)]
        return -float(np.log(found.scale)), float(np.hypot(scale.sigma, scale.common_sigma))

    def radius(self, log_error: float = 0.0) -> Tuple[float, float]:
        """Relative error of the mean wheel radius that is calibrated, and its sigma; nan where it is not told."""
        simulated = self.simulated
        model, simulation = robot_model(simulated.robot), simulated.simulation
        steps = list(wheel_steps(simulated.wheels, WheelOdometry(model, WheelConfig())))
        found = calibrate(steps, camera_poses(self.statuses), model, self.scales(log_error))
        told = [value for value in found.values if value.name == MEAN_RADIUS]
        if not told:
            return np.nan, np.nan
        true = float(np.sqrt(np.prod(simulation.robot.true.wheel_radius_m)))
        return _relative(told[0], true)


def _relative(value: CalibratedValue, true: float) -> Tuple[float, float]:
    return value.value / true - 1.0, value.sigma / true


def _told_by(rig: RigConfig, keyframe: KeyframeEstimate, log_error: float) -> KeyframeEstimate:
    scale = keyframe.scale
    common = float(np.hypot(scale.common_sigma, rig.baseline_sigma))
    return replace(keyframe, scale=scale._replace(log_scale=scale.log_scale + log_error, common_sigma=common))


def stereo(tracked: TrackedDrives, _: int, first: int = FIRST_ROOF, count: int = ROOFS) -> Iterator[Row]:
    """One lap of loops under each roof."""
    drives = [_drive(tracked, seed) for seed in range(first, first + count)]
    judged = [drive for drive in drives if drive.is_judged]
    yield from _rows(f"{len(judged)} roofs at {HEIGHTS_M[0]:g} to {HEIGHTS_M[1]:g} m", judged, is_judged=True)
    yield from _rows("all roofs", drives, is_judged=False)


def _drive(tracked: TrackedDrives, seed: int) -> StereoDrive:
    simulated = SimulatedRecording(draw_config("loops", seed, stereo=True))
    name = f"loops_stereo_{seed}"
    drive = StereoDrive(seed, simulated, tracked.kept.statuses(simulated, name, OdometryRun(config=EXACT)))
    error, sigma = drive.scale_error()
    tqdm.write(f"{name}: {drive.height_m[0]:.1f} to {drive.height_m[1]:.1f} m, "
               f"scale {100 * error:.2f} % +- {100 * sigma:.2f}")  # fmt: skip
    return drive


def _rows(subject: str, drives: Sequence[StereoDrive], is_judged: bool) -> Iterator[Row]:
    scales = np.reshape([drive.scale_error() for drive in drives], (-1, 2))
    radii = np.reshape([drive.radius() for drive in drives], (-1, 2))
    wrong = np.reshape([drive.radius(np.log1p(WRONG_BASELINE)) for drive in drives], (-1, 2))
    limits: List[float] = [SCALE_PERCENT, RADIUS_PERCENT] if is_judged else [np.inf, np.inf]
    yield Row(subject, f"error of the scale after {WAY_M:g} m, %", 100 * np.abs(scales[:, 0]), limits[0])
    yield Row(subject, "mean NEES of the scale", [float(np.nanmean((scales[:, 0] / scales[:, 1]) ** 2))],
              *(NEES[::-1] if is_judged else ()))  # fmt: skip
    yield Row(subject, "error of the mean wheel radius, %", 100 * np.abs(radii[:, 0]), limits[1])
    yield Row(
        subject, f"the same with a baseline wrong by {100 * WRONG_BASELINE:g} %, in its sigmas",
        np.abs(wrong[:, 0] / wrong[:, 1]), 1.0 if is_judged else np.inf,
    )  # fmt: skip
