# SPDX-License-Identifier: BSD-3-Clause
"""`calibrate` on drives in halls drawn at random, with slips and a lens and a mount that are wrong."""

from dataclasses import dataclass, replace
from typing import Dict, Iterator, List, Tuple

import numpy as np
from scipy.spatial.transform import Rotation
from support.random_roofs import JUDGING
from support.table import Row

from ceiling_dso_ros.evaluation.alignment import AlignmentKind
from ceiling_dso_ros.experiments.fused_run import FusedRun
from ceiling_dso_ros.experiments.kept_runs import OdometryRun
from ceiling_dso_ros.experiments.rendered_drives import RenderedDrive
from ceiling_dso_ros.experiments.tracked_drives import TrackedDrives
from ceiling_dso_ros.experiments.tracked_run import TrackedRun
from ceiling_dso_ros.fusion.calibration import CalibratedValue, CalibrationError
from ceiling_dso_ros.fusion.config import WheelConfig
from ceiling_dso_ros.fusion.wheel import WheelOdometry
from ceiling_dso_ros.io.camera_models import CameraCalibration
from ceiling_dso_ros.io.lens_models import LensCamera
from ceiling_dso_ros.io.output_camera import crop_camera
from ceiling_dso_ros.io.recording import Frame, Recording, RobotDescription
from ceiling_dso_ros.io.recording_view import RecordingView
from ceiling_dso_ros.lens.calibrating import CameraAndRobot, calibrate_all
from ceiling_dso_ros.lens.observing import ObservedDrive, observe
from ceiling_dso_ros.lens.parameters import correctable, vector_of
from ceiling_dso_ros.playback.fusion_playback import robot_model
from ceiling_dso_ros.playback.visual_run import VisualRun
from ceiling_dso_ros.playback.wheel_playback import wheel_steps
from ceiling_dso_ros.simulation.drawn import draw_config, draw_lens_error

DRIVES, DURATION_S, SLIP = 20, 60.0, "slip"
SIGMAS, LEAST_SHARE = 3.0, 0.95
MOST_RATIO = 1.5  # of the errors with the true lens and mount
MISMOUNTED_DEG, MISPLACED_M = 1.0, 0.02  # largest errors of the mount before the calibration, along each axis


@dataclass(frozen=True)
class Known:
    """What a calibration knows of camera and robot."""

    camera: CameraCalibration
    robot: RobotDescription


class KnownRecording(RecordingView):
    """A recording seen with another calibration."""

    def __init__(self, recording: Recording, known: Known) -> None:
        super().__init__(recording)
        self.calibration = known.camera
        self._robot = known.robot

    @property
    def robot(self) -> RobotDescription:
        """See Recording."""
        return self._robot


def lenses(tracked: TrackedDrives, count: int) -> Iterator[Row]:
    """Whether each number is as sure as it says, and what the calibration is worth."""
    within: Dict[str, List[bool]] = {}
    camera_ratios, fused_ratios = [], []
    seeds = range(JUDGING, JUDGING + min(count, DRIVES))
    for seed in seeds:
        drive = tracked.rendered.drive(draw_config("loops", seed, duration_s=DURATION_S, events=(SLIP,)))
        wrong, true = _wrong(drive, seed), _true(drive)
        try:
            found = _calibrated(KnownRecording(drive.recording, wrong))
        except CalibrationError as error:
            yield Row(f"hall {seed}", f"not calibrated: {error}", [1], 0)
            continue
        for value, truth in _beside_truth(found, true):
            within.setdefault(value.name, []).append(abs(value.value - truth) <= SIGMAS * value.sigma)
        errors_m = [
            _errors_m(tracked, drive, known, name) for known, name in ((_known(found), "found"), (true, "true"))
        ]
        camera_ratios.append(errors_m[0][0] / errors_m[1][0])
        fused_ratios.append(errors_m[0][1] / errors_m[1][1])
    subject = f"random halls {seeds[0]} to {seeds[-1]}"
    for name, inside in within.items():
        yield Row(subject, f"{name}: within {SIGMAS:g} sigma, share", [float(np.mean(inside))])
    every = [each for inside in within.values() for each in inside]
    yield Row(subject, "all numbers: share", [float(np.mean(every))], low=LEAST_SHARE)
    yield Row(subject, "final ATE / with the true lens and mount", camera_ratios, MOST_RATIO)
    yield Row(subject, "fused ATE after Sim(2) / with the true ones", fused_ratios, MOST_RATIO)


def _true(drive: RenderedDrive) -> Known:
    simulation = drive.simulated.simulation
    return Known(_calibration(simulation.config.camera.lens), simulation.robot.true)


def _wrong(drive: RenderedDrive, seed: int) -> Known:
    """The nominal robot, with a mount and a lens that are wrong."""
    config = drive.simulated.simulation.config
    lens = replace(config.camera, lens_error=draw_lens_error(seed, config.camera.width)).told_lens
    rng = np.random.default_rng(seed)
    nominal = drive.simulated.robot
    T = nominal.T_base_camera.copy()
    T[:3, :3] = (
        Rotation.from_euler("XYZ", rng.uniform(-MISMOUNTED_DEG, MISMOUNTED_DEG, 3), True).as_matrix() @ T[:3, :3]
    )
    T[:2, 3] += rng.uniform(-MISPLACED_M, MISPLACED_M, 2)
    return Known(_calibration(lens), replace(nominal, T_base_camera=T))


def _calibration(lens: LensCamera) -> CameraCalibration:
    return CameraCalibration(lens, crop_camera(lens, lens.width, lens.height))


def _calibrated(recording: KnownRecording) -> CameraAndRobot:
    wheels = recording.wheels
    if wheels is None:
        raise TypeError(f"{recording.path} has no wheels")
    robot = robot_model(recording.robot)
    steps = list(wheel_steps(wheels, WheelOdometry(robot, WheelConfig())))

    def tracked(camera: CameraCalibration) -> ObservedDrive:
        visual = VisualRun.of_camera(camera, recording.photometric)
        return observe(visual, (frame for frame in recording.frames() if isinstance(frame, Frame)))

    return calibrate_all(steps, robot, recording.calibration, tracked)


def _known(found: CameraAndRobot) -> Known:
    robot = found.robot.robot
    described = RobotDescription(
        robot.ticks_per_turn,
        robot.wheel_radius_m,
        robot.wheel_base_m,
        robot.T_base_camera,
        robot.camera_time_offset_s,
    )
    return Known(found.camera, described)


def _beside_truth(found: CameraAndRobot, true: Known) -> Iterator[Tuple[CalibratedValue, float]]:
    """The numbers that the drive told, each with its true value."""
    robot = true.robot
    yaw, pitch, roll = Rotation.from_matrix(robot.T_base_camera[:3, :3]).as_euler("ZYX", degrees=True)
    ratio = robot.wheel_radius_m[1] / robot.wheel_radius_m[0]
    of_robot = (roll, pitch, yaw, *robot.T_base_camera[:2, 3], robot.camera_time_offset_s, ratio, robot.wheel_base_m)
    of_lens = vector_of(correctable(true.camera.lens))
    for value, truth in (*zip(found.lens_values, of_lens), *zip(found.robot.values, of_robot)):
        if value.excited:
            yield value, float(truth)


def _errors_m(tracked: TrackedDrives, drive: RenderedDrive, known: Known, name: str) -> Tuple[float, float]:
    """Error of the camera and of the fused pose."""
    recording = KnownRecording(drive.recording, known)
    statuses = tracked.kept.statuses(recording, f"{drive.name} with the {name} lens", OdometryRun(predict=True))
    truths = drive.simulated.camera_truth, drive.simulated.base_truth
    fused = FusedRun(recording, statuses, *truths)
    return TrackedRun(statuses, truths[0]).final_ate_m, fused.ate_m(fused.playback.fused(), AlignmentKind.SIM2)
