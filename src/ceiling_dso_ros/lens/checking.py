# SPDX-License-Identifier: BSD-3-Clause
"""Whether a recording's calibration fits its images."""

from typing import Optional, Sequence

import numpy as np
from scipy.stats import chi2

from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.fusion.calibration import CalibrationError, calibrate
from ceiling_dso_ros.fusion.config import RobotModel, WheelConfig
from ceiling_dso_ros.fusion.wheel import WheelOdometry
from ceiling_dso_ros.fusion.wheel_motion import WheelStep
from ceiling_dso_ros.io.lens_models import LensCamera
from ceiling_dso_ros.io.recording import Recording
from ceiling_dso_ros.lens.finding import FoundDrive, find
from ceiling_dso_ros.lens.observing import DriveObserver, ObservedDrive
from ceiling_dso_ros.lens.parameters import correctable, names_of, pixels_of, rays_of, vector_of
from ceiling_dso_ros.lens.state import LENS
from ceiling_dso_ros.lens.tracks import follow
from ceiling_dso_ros.playback.fusion_playback import robot_model
from ceiling_dso_ros.playback.wheel_playback import wheel_steps

MOST_KEYFRAMES, CORNERS = 80, 30  # that are looked at: enough for a lens that is wrong by a pixel
FALSE_ALARM = 5.7e-7  # probability, that of 5 standard deviations
NAMED = 3.0  # standard deviations of a single number
LEAST_PX = 0.5  # what a careful calibration is wrong by: less costs next to nothing
GRID = 9  # points along each side of the image


class LensCheck:
    """Watches a run and says whether the camera's calibration fits. Needs wheels."""

    def __init__(self, recording: Recording, camera: PinholeCamera) -> None:
        """Begin; the camera is that of the undistorted images."""
        self._recording = recording
        self._observer = DriveObserver(camera, MOST_KEYFRAMES)
        self.add = self._observer.add

    def problem(self) -> Optional[str]:
        """What does not fit, in one line; None if the lens fits or the drive does not tell."""
        wheels, description = self._recording.wheels, self._recording.robot
        if wheels is None or description is None:
            return None
        robot = robot_model(description)
        steps = list(wheel_steps(wheels, WheelOdometry(robot, WheelConfig())))
        return lens_problem(self._observer.drive(), steps, robot, self._recording.calibration.lens)


def lens_problem(
    drive: ObservedDrive, steps: Sequence[WheelStep], robot: RobotModel, lens: LensCamera
) -> Optional[str]:
    """What does not fit, in one line; None if the lens fits or the drive does not tell.

    Args:
        drive: tracked with this lens.
        steps: of the wheels.
        robot: as it is known.
        lens: the recording's.
    """
    try:
        guess = calibrate(steps, drive.poses, robot).robot
        found = find(drive.keyframes, follow(drive.keyframes, lens, CORNERS), steps, robot, guess, lens, lens)
    except CalibrationError:
        return None
    return misfit(found, lens)


def fits(found: FoundDrive, lens: LensCamera, false_alarm: float) -> bool:
    """Whether a lens fits what was found, or makes no difference.

    Args:
        found: of a drive.
        lens: to be judged.
        false_alarm: probability that a lens does not fit that is right.
    """
    change = vector_of(found.state.lens) - vector_of(correctable(lens))
    is_near = change @ np.linalg.solve(found.covariance[LENS, LENS], change) < chi2.isf(false_alarm, len(change))
    return bool(is_near or _apart_px(found, lens) < LEAST_PX)


def misfit(found: FoundDrive, lens: LensCamera) -> Optional[str]:
    """In what a lens does not fit what was found, in one line; None if it does, or if it makes no difference."""
    if fits(found, lens, FALSE_ALARM):
        return None
    change = vector_of(found.state.lens) - vector_of(correctable(lens))
    sigmas = np.sqrt(np.diag(found.covariance[LENS, LENS]))
    far = np.abs(change) / sigmas
    parts = [
        f"{name} {value:+.2g} +- {sigma:.1g}"
        for name, value, sigma, is_far in zip(names_of(lens), change, sigmas, far >= min(NAMED, far.max()))
        if is_far
    ]
    return (
        f"the camera's calibration does not fit its images, which differ from it by {', '.join(parts)}: `calibrate` "
        "finds the lens together with the mounting"
    )


def _apart_px(found: FoundDrive, lens: LensCamera) -> float:
    """Root mean square distance over the image between what both lenses show of a direction, pixels."""
    u, v = np.meshgrid(np.linspace(0, lens.width - 1, GRID), np.linspace(0, lens.height - 1, GRID))
    pixels = np.column_stack([u.ravel(), v.ravel()])
    guess = (pixels - [lens.cx, lens.cy]) / [lens.fx, lens.fy]
    rays = rays_of(lens, pixels, guess)
    change = pixels_of(found.state.lens, rays) - pixels
    return float(np.sqrt(np.mean(np.square(change).sum(axis=1))))
