# SPDX-License-Identifier: BSD-3-Clause
"""Calibration from a recording: camera mounting, wheel dimensions, and time offset of the camera.

Between two images, camera and wheels measure the same motion of the base (planar hand-eye calibration):

    R_bc R_vo R_bc^T = Rz(phi),    s R_bc t_vo = (t + (Rz(phi) - I) a, 0)

with the camera's rotation R_bc and position a in the base, metres per unit s, and the wheels' motion (t, phi) between
the images' stamps plus the time offset, which depends on ratio and base. It is solved by robust least squares over all
pairs of images, with residuals weighted by their scatter. Pairs between which the wheels slipped are then left out,
until no other ones are found: a robust loss alone would let slips move the result by several standard deviations.
"""

import math
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Mapping, Optional, Sequence, Tuple

import numpy as np
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.fusion.calibration_data import CameraPose, ImagePair, WheelPath, image_pairs
from ceiling_dso_ros.fusion.calibration_problem import MountingProblem, Solution, first_guess
from ceiling_dso_ros.fusion.calibration_radius import metric_poses, radius_error
from ceiling_dso_ros.fusion.calibration_slips import WheelSlip, beside, contradicting, described, follows, slipping
from ceiling_dso_ros.fusion.config import RobotModel
from ceiling_dso_ros.fusion.metric_scale import SegmentScale
from ceiling_dso_ros.fusion.wheel_motion import WheelStep

MIN_PAIRS = 10
ROUNDS = 10  # of leaving slips out; two are usual
MEAN_RADIUS = "mean wheel radius"
BY_WHEELS = ("camera x", "camera y", "wheel base")  # lengths that the wheels measure
ALWAYS_UNOBSERVABLE = "camera z"
LARGEST_RADIUS_SIGMA = 0.01  # relative: a radius that is known worse is better measured by hand

# estimated values: name, unit, and the standard deviation below which a value counts as determined
PARAMETERS = (
    ("camera roll", "deg", 0.5),
    ("camera pitch", "deg", 0.5),
    ("camera yaw", "deg", 0.5),
    ("camera x", "m", 0.02),
    ("camera y", "m", 0.02),
    ("camera time offset", "s", 0.005),
    ("wheel ratio right/left", "", 0.005),
    ("wheel base", "m", 0.005),
)


class CalibrationError(ValueError):
    """The recording does not allow a calibration; the message says what is missing."""


@dataclass(frozen=True)
class CalibratedValue:
    """One result.

    Attributes:
        name, unit: of it.
        value, sigma: with its standard deviation, in that unit.
        nominal: the value before the calibration.
        excited: whether the motion determines it; otherwise the value must not be used.
    """

    name: str
    unit: str
    value: float
    sigma: float
    nominal: float
    excited: bool


@dataclass(frozen=True)
class Calibration:
    """All results.

    Attributes:
        values: one for each of PARAMETERS, and MEAN_RADIUS where a second camera tells it.
        robot: the robot with the values that the motion determines; the others stay nominal.
        pairs: how many pairs of images were used.
        left_out: how many were not, because the wheels slipped then or shortly before or after.
        slips: these times.
    """

    values: Tuple[CalibratedValue, ...]
    robot: RobotModel
    pairs: int
    left_out: int
    slips: Tuple[WheelSlip, ...]


def calibrate(
    steps: Sequence[WheelStep],
    poses: Sequence[CameraPose],
    robot: RobotModel,
    scales: Mapping[int, SegmentScale] = MappingProxyType({}),
) -> Calibration:
    """Estimate camera mounting, time offset, wheel ratio and wheel base, with a second camera the mean wheel radius.

    Args:
        steps: of the wheels, one after the other, by the nominal dimensions.
        poses: of the camera, all tracked images in order.
        robot: nominal dimensions; of the camera's mounting it is enough to know that it looks upward.
        scales: segment -> its scale by a second camera, as of `segment_scales`.

    Raises:
        CalibrationError: too little motion that both sensors have measured, or they disagree about most of it.
    """
    if not steps:
        raise CalibrationError("the wheels have no samples with growing stamps")
    wheels = WheelPath(steps, robot.wheel_base_m)
    pairs = image_pairs(poses, wheels)
    if len(pairs) < MIN_PAIRS:
        raise CalibrationError(
            f"only {len(pairs)} pairs of images with motion between them, {MIN_PAIRS} are needed: drive for longer"
        )
    solution, used, slips = _without_slips(wheels, pairs, robot)
    values = described_values(solution.values, np.sqrt(np.diag(solution.covariance)), robot)
    values = with_radius(values, _mean_radius(wheels, poses, robot, scales))
    count = int(np.count_nonzero(used))
    return Calibration(values, applied(values, robot), count, len(pairs) - count, slips)


def _without_slips(
    wheels: WheelPath, pairs: Sequence[ImagePair], robot: RobotModel
) -> Tuple[Solution, np.ndarray, Tuple[WheelSlip, ...]]:
    """The solution, which pairs it used, (n,) bool, and what it left out."""
    problem = MountingProblem(wheels, pairs, robot)
    motions = wheels.motions(pairs, 0.0, 0.0, 0.0)
    way_m = np.hypot(*motions[:, :2].T) + 0.5 * robot.wheel_base_m * np.abs(motions[:, 2])
    guess, used = first_guess(wheels, pairs, robot), np.ones(len(pairs), bool)
    follow, kept = follows(pairs), used
    for _ in range(ROUNDS):
        used = kept
        solution = problem.solve(guess, used)
        slips = slipping(solution.excess_m, used, way_m, follow)
        kept = ~beside(slips, follow)
        guess = solution.guess
        wrong = max(np.count_nonzero(~kept), int(np.count_nonzero(contradicting(solution.excess_m, way_m))))
        if len(pairs) - wrong < max(MIN_PAIRS, len(pairs) // 2):
            raise CalibrationError(
                f"wheels and camera disagree about {wrong} of {len(pairs)} pairs of images: the wheels slip, or the "
                "joints or the dimensions are those of another robot"
            )
        if (kept == used).all():
            break
    return solution, used, described(pairs, slips, solution.excess_m)


def _mean_radius(
    wheels: WheelPath, poses: Sequence[CameraPose], robot: RobotModel, scales: Mapping[int, SegmentScale]
) -> Optional[CalibratedValue]:
    """The mean wheel radius, if a second camera has told metres in a part of the drive that is long enough."""
    pairs = image_pairs(metric_poses(poses, scales), wheels)
    if len(pairs) < MIN_PAIRS:
        return None
    try:
        solution, used, _ = _without_slips(wheels, pairs, robot)
    except CalibrationError:
        return None
    turns = wheels.motions(pairs, 0.0, 0.0, 0.0)[:, 2]
    kept = [pair for pair, is_used in zip(pairs, used) if is_used]
    found = radius_error(kept, solution.forward[used], turns[used], scales)
    nominal = mean_radius_m(robot)
    return CalibratedValue(
        MEAN_RADIUS, "m", nominal * math.exp(found.log_ratio), nominal * found.sigma, nominal,
        found.sigma < LARGEST_RADIUS_SIGMA,
    )  # fmt: skip


def with_radius(values: Sequence[CalibratedValue], radius: Optional[CalibratedValue]) -> Tuple[CalibratedValue, ...]:
    """The values of PARAMETERS, found with the nominal mean radius, with that radius; as they are without one.

    What is measured by wheels that turn further is longer, too.
    """
    if radius is None:
        return tuple(values)
    if not radius.excited:
        return (*values, radius)
    gain, sigma = radius.value / radius.nominal, radius.sigma / radius.nominal
    return (*(_longer(each, gain, sigma) if each.name in BY_WHEELS else each for each in values), radius)


def _longer(value: CalibratedValue, gain: float, gain_sigma: float) -> CalibratedValue:
    return replace(value, value=gain * value.value, sigma=math.hypot(gain * value.sigma, gain_sigma * value.value))


def mean_radius_m(robot: RobotModel) -> float:
    """Geometric mean of the two wheels' radii, metres."""
    return math.sqrt(robot.wheel_radius_m[0] * robot.wheel_radius_m[1])


def described_values(solution: np.ndarray, sigmas: np.ndarray, robot: RobotModel) -> Tuple[CalibratedValue, ...]:
    """Results in the units of PARAMETERS, from values and standard deviations (8,) as `Solution` has them."""
    yaw, pitch, roll = Rotation.from_matrix(robot.T_base_camera[:3, :3]).as_euler("ZYX")
    nominal = np.array([roll, pitch, yaw, *robot.T_base_camera[:2, 3], robot.camera_time_offset_s, 0.0, 0.0])
    ratio = robot.wheel_radius_m[1] / robot.wheel_radius_m[0]
    yaw_excited = math.degrees(sigmas[2]) < PARAMETERS[2][2]
    values = []
    for (name, unit, limit), value, sigma, before in zip(PARAMETERS, solution, sigmas, nominal):
        excited = (math.degrees(sigma) if unit == "deg" else sigma) < limit
        if name in ("camera x", "camera y"):  # with turns alone, their direction cannot be separated from the yaw
            excited = excited and yaw_excited
        if unit == "deg":
            value, sigma, before = (math.degrees(angle) for angle in (value, sigma, before))
        elif name.startswith("wheel"):  # logarithms relative to nominal
            before = ratio if "ratio" in name else robot.wheel_base_m
            value, sigma = before * math.exp(value), before * sigma
        values.append(CalibratedValue(name, unit, float(value), float(sigma), float(before), bool(excited)))
    return tuple(values)


def applied(values: Sequence[CalibratedValue], robot: RobotModel) -> RobotModel:
    """The robot with those of the values that are determined: of PARAMETERS, and MEAN_RADIUS where it is told."""
    roll, pitch, yaw, x, y, offset_s, ratio, base, *told = (v.value if v.excited else v.nominal for v in values)
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("ZYX", [yaw, pitch, roll], degrees=True).as_matrix()
    T[:3, 3] = x, y, robot.T_base_camera[2, 3]
    mean = told[0] if told else mean_radius_m(robot)
    radii = (mean / math.sqrt(ratio), mean * math.sqrt(ratio))
    return replace(robot, T_base_camera=T, wheel_base_m=base, wheel_radius_m=radii, camera_time_offset_s=offset_s)
