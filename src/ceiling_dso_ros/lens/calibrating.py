# SPDX-License-Identifier: BSD-3-Clause
"""Calibration of camera and robot from one drive: passes of the odometry, each in the lens that the last one found."""

from dataclasses import dataclass, replace
from typing import Callable, List, Optional, Sequence, Tuple

import numpy as np

from ceiling_dso_ros.fusion.calibration import (
    MEAN_RADIUS,
    CalibratedValue,
    Calibration,
    CalibrationError,
    applied,
    calibrate,
    described_values,
    with_radius,
)
from ceiling_dso_ros.fusion.config import RobotModel
from ceiling_dso_ros.fusion.wheel_motion import WheelStep
from ceiling_dso_ros.io.camera_models import CameraCalibration
from ceiling_dso_ros.io.output_camera import crop_camera
from ceiling_dso_ros.lens.checking import fits
from ceiling_dso_ros.lens.finding import FoundDrive, find, in_calibration_order, prior_of
from ceiling_dso_ros.lens.observing import ObservedDrive
from ceiling_dso_ros.lens.parameters import correctable, names_of, vector_of
from ceiling_dso_ros.lens.state import LENS
from ceiling_dso_ros.lens.tracks import follow

PASSES = 4
SMALL_CHANGE = 1.0  # standard deviations: other images of the same drive would change as much
# A right lens is changed as often as this. Where a drive tells lens and mount only together, as under a flat ceiling,
# a change makes the camera's own path worse.
NEEDLESS = 0.05
TOLD_SHARE = 0.3  # of the standard deviation before: above it, the value is not told by the drive


@dataclass(frozen=True)
class CameraAndRobot:
    """What a drive tells.

    Attributes:
        lens_values: of the lens, each with its standard deviation and whether the drive told it.
        camera: the corrected camera; that of the recording if it fits the images.
        robot: the rest, seen through that camera.
        passes: of the odometry.
        lens_stays: the recording's calibration fits the images.
    """

    lens_values: Tuple[CalibratedValue, ...]
    camera: CameraCalibration
    robot: Calibration
    passes: int
    lens_stays: bool


def calibrate_all(
    steps: Sequence[WheelStep], robot: RobotModel, camera: CameraCalibration,
    observe: Callable[[CameraCalibration], ObservedDrive],
) -> CameraAndRobot:  # fmt: skip
    """Find lens, mount, clock and wheel dimensions.

    Args:
        steps: of the wheels, by the nominal dimensions.
        robot: nominal dimensions.
        camera: the recording's calibration.
        observe: tracks the drive with a calibration.

    Raises:
        CalibrationError: too little to see, or too little motion.
    """
    current = camera
    results: List[FoundDrive] = []
    while len(results) < PASSES and (len(results) < 2 or _change(*results[-2:]) > SMALL_CHANGE):
        drive = observe(current)
        through_lens = calibrate(steps, drive.poses, robot, drive.scales)
        tracks = follow(drive.keyframes, current.lens)
        found = find(drive.keyframes, tracks, steps, robot, through_lens.robot, camera.lens, current.lens)
        if not results and fits(found, camera.lens, NEEDLESS):
            values = tuple(replace(value, value=value.nominal) for value in _lens_values(found, camera, robot))
            return CameraAndRobot(values, camera, through_lens, 1, lens_stays=True)
        results.append(found)
        current = _corrected(found, camera)
    radius = next((value for value in through_lens.values if value.name == MEAN_RADIUS), None)
    return _described(results[-1], camera, current, robot, len(results), radius)


def _corrected(found: FoundDrive, camera: CameraCalibration) -> CameraCalibration:
    lens = found.state.lens
    try:
        return CameraCalibration(lens, crop_camera(lens, camera.camera.width, camera.camera.height))
    except ValueError as error:
        raise CalibrationError(f"the images do not tell the lens ({error}); --keep-lens leaves it as it is") from error


def _change(before: FoundDrive, found: FoundDrive) -> float:
    """Largest change of a number of the lens, in standard deviations."""
    sigmas = np.sqrt(np.diag(found.covariance)[LENS])
    return float(np.max(np.abs(vector_of(found.state.lens) - vector_of(before.state.lens)) / sigmas))


def _described(
    found: FoundDrive, before: CameraCalibration, camera: CameraCalibration, robot: RobotModel, passes: int,
    radius: Optional[CalibratedValue],
) -> CameraAndRobot:  # fmt: skip
    values, covariance = in_calibration_order(found)
    of_robot = with_radius(described_values(values[6:], np.sqrt(np.diag(covariance))[6:], robot), radius)
    result = Calibration(of_robot, applied(of_robot, robot), found.pairs, found.left_out, found.slips)
    return CameraAndRobot(_lens_values(found, before, robot), camera, result, passes, lens_stays=False)


def _lens_values(found: FoundDrive, before: CameraCalibration, robot: RobotModel) -> Tuple[CalibratedValue, ...]:
    values, covariance = in_calibration_order(found)
    sigmas = np.sqrt(np.diag(covariance))
    known = np.sqrt(np.diag(np.linalg.inv(prior_of(robot, before.lens).information))[LENS])
    nominal = vector_of(correctable(before.lens))
    return tuple(
        CalibratedValue(
            name,
            "px" if number < 4 else "",
            float(values[number]),
            float(sigmas[number]),
            float(nominal[number]),
            bool(sigmas[number] < TOLD_SHARE * known[number]),
        )
        for number, name in enumerate(names_of(before.lens))
    )
