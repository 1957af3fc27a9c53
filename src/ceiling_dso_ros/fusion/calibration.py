"""Calibration from a recording: where the camera sits on the robot, what its wheels are like, whose clock is late.

Between two images the camera and the wheels tell the same motion of the base (hand-eye calibration in the plane):

    R_bc R_vo R_bc^T = Rz(phi),    s R_bc t_vo = (t + (Rz(phi) - I) a, 0)

with the camera's rotation R_bc and position a in the base, metres per unit s, and the wheels' motion (t, phi) between
the images' stamps plus the time offset, as ratio and base make it. Least squares over all pairs of images, robust, the
residuals weighted by how much they are found to scatter.
"""

import math
from dataclasses import dataclass, replace
from typing import List, Sequence, Tuple

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.config import RobotModel
from ceiling_dso_ros.fusion.wheel import WheelStep

PAIR_S = 0.4  # between the images of a pair
LARGEST_OFFSET_S = 0.2
ALWAYS_UNOBSERVABLE = ("camera z", "mean wheel radius")

# what is estimated: name, unit, standard deviation of the prior about the nominal value, and of a value that is usable
PARAMETERS = (
    ("camera roll", "deg", 20.0, 0.5),
    ("camera pitch", "deg", 20.0, 0.5),
    ("camera yaw", "deg", 180.0, 0.5),
    ("camera x", "m", 1.0, 0.02),
    ("camera y", "m", 1.0, 0.02),
    ("camera time offset", "s", 0.1, 0.005),
    ("wheel ratio right/left", "", 0.1, 0.005),
    ("wheel base", "m", 0.1, 0.005),
)
SCALE_PRIOR = (math.log(4.0), 1.0)  # metres per unit: logarithm and its standard deviation
PRIOR_SIGMAS = np.array([math.radians(p[2]) if p[1] == "deg" else p[2] for p in PARAMETERS])
FIRST_SIGMAS = np.array([1e-3, 2e-3, 2e-3, 5e-4, 5e-4, 5e-4])  # of a pair's residuals


class CalibrationError(ValueError):
    """The recording does not allow a calibration; the message says what is missing."""


@dataclass(frozen=True)
class CalibratedValue:
    """One result.

    Attributes:
        name, unit: of it.
        value, sigma: with its standard deviation, in that unit.
        nominal: what was believed before.
        excited: the motion determines it; otherwise the value is worth nothing.
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
        values: one for each of PARAMETERS.
        robot: the robot with the values that the motion determines; the others stay nominal.
        pairs: how many pairs of images were used.
    """

    values: Tuple[CalibratedValue, ...]
    robot: RobotModel
    pairs: int


@dataclass(frozen=True)
class CameraPose:
    """Pose of the camera at an image: stamp, segment of the visual odometry, (4, 4) in its world and unit."""

    stamp_s: float
    segment: int
    T_world_camera: np.ndarray


def calibrate(steps: Sequence[WheelStep], poses: Sequence[CameraPose], robot: RobotModel) -> Calibration:
    """Estimate camera mounting, time offset, wheel ratio and wheel base.

    Args:
        steps: of the wheels, one after the other, by the nominal dimensions.
        poses: of the camera, all tracked images in order.
        robot: nominal dimensions; what it says of the camera need not be more than roughly upward.

    Raises:
        CalibrationError: too little motion that both have seen.
    """
    wheels = _WheelPath(steps, robot.wheel_base_m)
    pairs = _pairs(poses, wheels)
    if len(pairs) < 10:
        raise CalibrationError(
            f"only {len(pairs)} pairs of images with motion between them, at least 10 are needed: drive for longer"
        )
    problem = _Problem(wheels, pairs, robot)
    solution, covariance = problem.solve(_first_guess(wheels, pairs, robot))
    values = _describe(solution, np.sqrt(np.diag(covariance)), robot)
    return Calibration(values, _apply(values, robot), len(pairs))


@dataclass(frozen=True)
class _Pair:
    start_s: float
    end_s: float
    segment: int
    rotation: np.ndarray
    translation: np.ndarray


class _WheelPath:
    """The wheels' path as a function of ratio and base."""

    def __init__(self, steps: Sequence[WheelStep], wheel_base_m: float) -> None:
        self.stamps_s = np.array([steps[0].start_s, *(step.end_s for step in steps)])
        self._ages_s = self.stamps_s - self.stamps_s[0]  # small numbers, which can be shifted by nanoseconds
        self._twists = np.array([step.twist for step in steps])
        self._base = wheel_base_m

    def poses(self, ages_s: np.ndarray, ratio: float, base: float) -> np.ndarray:
        """(n, 3) x, y, unwrapped yaw at seconds after the first; logarithms of ratio and base relative to nominal."""
        forward, left, turn = self._twists.T
        half = 0.5 * self._base * turn
        left_wheel, right_wheel = (forward - half) * math.exp(-0.5 * ratio), (forward + half) * math.exp(0.5 * ratio)
        forward, turn = 0.5 * (left_wheel + right_wheel), (right_wheel - left_wheel) / (self._base * math.exp(base))
        yaw = np.concatenate([[0.0], np.cumsum(turn)])
        middle = yaw[:-1] + 0.5 * turn
        dx, dy = np.cos(middle) * forward - np.sin(middle) * left, np.sin(middle) * forward + np.cos(middle) * left
        path = np.column_stack([np.concatenate([[0.0], np.cumsum(dx)]), np.concatenate([[0.0], np.cumsum(dy)]), yaw])
        return np.column_stack([np.interp(ages_s, self._ages_s, column) for column in path.T])

    def motions(self, pairs: Sequence[_Pair], offset_s: float, ratio: float, base: float) -> np.ndarray:
        """(n, 3) motion between the images of each pair, seen from the first."""
        start_s, end_s = (np.array([[p.start_s, p.end_s] for p in pairs]) - self.stamps_s[0]).T
        first = self.poses(start_s + offset_s, ratio, base)
        second = self.poses(end_s + offset_s, ratio, base)
        c, s = np.cos(first[:, 2]), np.sin(first[:, 2])
        dx, dy, turn = (second - first).T
        return np.column_stack([c * dx + s * dy, c * dy - s * dx, turn])


def _pairs(poses: Sequence[CameraPose], wheels: _WheelPath) -> List[_Pair]:
    """Consecutive images PAIR_S apart, within the wheels' record, between which the robot moved."""
    first_s, last_s = wheels.stamps_s[0] + LARGEST_OFFSET_S, wheels.stamps_s[-1] - LARGEST_OFFSET_S
    pairs, before = [], None
    for pose in poses:
        if not first_s <= pose.stamp_s <= last_s:
            continue
        if before is not None and pose.segment == before.segment and pose.stamp_s - before.stamp_s < PAIR_S:
            continue
        if before is not None and pose.segment == before.segment:
            T = np.linalg.inv(before.T_world_camera) @ pose.T_world_camera
            pairs.append(_Pair(before.stamp_s, pose.stamp_s, pose.segment, T[:3, :3], T[:3, 3]))
        before = pose
    if not pairs:
        return pairs
    moved = wheels.motions(pairs, 0.0, 0.0, 0.0)
    return [pair for pair, motion in zip(pairs, moved) if np.hypot(*motion[:2]) > 0.02 or abs(motion[2]) > 0.02]


def _first_guess(wheels: _WheelPath, pairs: Sequence[_Pair], robot: RobotModel) -> np.ndarray:
    """Rotation vector of R_bc, x, y, time offset, ratio, base, and the log-scale of each segment, in closed form."""
    rotations = Rotation.from_matrix([pair.rotation for pair in pairs]).as_rotvec()
    offsets = np.arange(-LARGEST_OFFSET_S, LARGEST_OFFSET_S + 0.005, 0.01)
    axes = [wheels.motions(pairs, offset, 0.0, 0.0)[:, 2] @ rotations for offset in offsets]
    best = int(np.argmax(np.linalg.norm(axes, axis=1)))
    turned = np.abs(wheels.motions(pairs, 0.0, 0.0, 0.0)[:, 2]).sum()
    R, offset = robot.T_base_camera[:3, :3], 0.0
    if turned > 1.0:  # the axis of all turns is the base's z axis
        offset = offsets[best]
        R = _upright(axes[best])
    yaw, lever, log_scales = _first_translation(R, wheels.motions(pairs, offset, 0.0, 0.0), pairs, robot)
    R = Rotation.from_euler("z", yaw).as_matrix() @ R
    return np.concatenate([Rotation.from_matrix(R).as_rotvec(), lever, [offset, 0.0, 0.0], log_scales])


def _upright(axis: np.ndarray) -> np.ndarray:
    """(3, 3) smallest rotation that turns an axis into the z axis."""
    sideways = np.array([axis[1], -axis[0], 0.0])
    angle = math.atan2(np.linalg.norm(sideways), axis[2])
    return Rotation.from_rotvec(angle * sideways / max(np.linalg.norm(sideways), 1e-12)).as_matrix()


def _first_translation(
    R: np.ndarray, motions: np.ndarray, pairs: Sequence[_Pair], robot: RobotModel
) -> Tuple[float, np.ndarray, np.ndarray]:
    """Yaw of the camera, its x and y, and the log-scales: linear in s_k (cos, sin) of the first segment and x, y."""
    segments = sorted({pair.segment for pair in pairs})
    rows, rhs = [], []
    for pair, motion in zip(pairs, motions):
        u, v = (R @ pair.translation)[:2]
        columns = np.zeros((2, 2 * len(segments) + 2))
        where = 2 * segments.index(pair.segment)
        columns[:, where : where + 2] = [[u, -v], [v, u]]
        columns[:, -2:] = np.eye(2) - planar.rotation(motion[2])
        rows.append(columns)
        rhs.append(motion[:2])
    weak = np.zeros((2, 2 * len(segments) + 2))  # x and y stay where they were believed when nothing tells them
    weak[:, -2:] = 0.02 * np.eye(2)
    solution = np.linalg.lstsq(
        np.vstack([*rows, weak]), np.concatenate([*rhs, 0.02 * robot.T_base_camera[:2, 3]]), rcond=None
    )[0]
    turns = solution[:-2].reshape(-1, 2)
    if np.linalg.norm(turns, axis=1).min() < 0.1:  # hardly any way: nothing but turns on the spot
        return 0.0, robot.T_base_camera[:2, 3], np.full(len(segments), SCALE_PRIOR[0])
    weights = np.array([sum(pair.segment == segment for pair in pairs) for segment in segments])
    direction = (weights[:, None] * turns / np.linalg.norm(turns, axis=1, keepdims=True)).sum(axis=0)
    return math.atan2(direction[1], direction[0]), solution[-2:], np.log(np.linalg.norm(turns, axis=1))


class _Problem:
    """Residuals of all pairs, six each: yaw, tilt (2), and in units of the visual odometry x, y and climb.

    In units, since in metres noise of the camera would make the scale shrink.
    """

    def __init__(self, wheels: _WheelPath, pairs: Sequence[_Pair], robot: RobotModel) -> None:
        self._wheels = wheels
        self._pairs = pairs
        self._height_m = robot.T_base_camera[2, 3]
        self._rotations = np.array([pair.rotation for pair in pairs])
        self._translations = np.array([pair.translation for pair in pairs])
        segments = sorted({pair.segment for pair in pairs})
        self._segment = np.array([segments.index(pair.segment) for pair in pairs])
        R_nominal = Rotation.from_matrix(robot.T_base_camera[:3, :3])
        self._nominal = (R_nominal, robot.T_base_camera[:2, 3], robot.camera_time_offset_s)
        self._sigmas = FIRST_SIGMAS

    def solve(self, guess: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """The parameters in the order of PARAMETERS (rad, m, s, logarithms), and their covariance."""
        self._R = Rotation.from_rotvec(guess[:3])
        parameters = np.concatenate([np.zeros(3), guess[3:]])
        for _ in range(3):
            found = least_squares(self._weighted, parameters, loss="soft_l1", f_scale=3.0, x_scale="jac")
            parameters = found.x
            residuals = self._residuals(parameters)
            scatter = 1.4826 * np.median(np.abs(residuals), axis=0)
            self._sigmas = np.maximum(scatter, 1e-6)
        covariance = np.linalg.inv(found.jac.T @ found.jac)[: len(PARAMETERS), : len(PARAMETERS)]
        to_angles = np.eye(len(PARAMETERS))
        angles = self._angles(parameters[:3])
        for axis, step in enumerate(1e-6 * np.eye(3)):
            to_angles[:3, axis] = (self._angles(parameters[:3] + step) - angles) / 1e-6
        return np.concatenate([angles, parameters[3:8]]), to_angles @ covariance @ to_angles.T

    def _angles(self, turn: np.ndarray) -> np.ndarray:
        """Roll, pitch, yaw of the camera that a rotation vector in the base makes of the first guess."""
        return (Rotation.from_rotvec(turn) * self._R).as_euler("ZYX")[::-1]

    def _weighted(self, parameters: np.ndarray) -> np.ndarray:
        R_nominal, lever, offset_s = self._nominal
        R = Rotation.from_rotvec(parameters[:3]) * self._R
        nominal = np.concatenate(
            [(R * R_nominal.inv()).as_rotvec(), parameters[3:5] - lever, [parameters[5] - offset_s]]
        )
        prior = np.concatenate([nominal, parameters[6:8]]) / PRIOR_SIGMAS
        scale = (parameters[8:] - SCALE_PRIOR[0]) / SCALE_PRIOR[1]
        return np.concatenate([(self._residuals(parameters) / self._sigmas).ravel(), prior, scale])

    def _residuals(self, parameters: np.ndarray) -> np.ndarray:
        R = (Rotation.from_rotvec(parameters[:3]) * self._R).as_matrix()
        lever, (offset_s, ratio, base) = parameters[3:5], parameters[5:8]
        units_per_m = np.exp(-parameters[8:])[self._segment]
        turned = R @ self._rotations @ R.T
        seen = self._translations @ R.T
        x, y, phi = self._wheels.motions(self._pairs, offset_s, ratio, base).T
        yaw = np.arctan2(turned[:, 1, 0] - turned[:, 0, 1], turned[:, 0, 0] + turned[:, 1, 1])
        tilt = turned[:, :2, 2]
        c, s = np.cos(phi), np.sin(phi)
        swing = np.column_stack([(c - 1.0) * lever[0] - s * lever[1], s * lever[0] + (c - 1.0) * lever[1]])
        shift = seen[:, :2] - units_per_m[:, None] * (np.column_stack([x, y]) + swing + self._height_m * tilt)
        return np.column_stack([np.angle(np.exp(1j * (yaw - phi))), tilt, shift, seen[:, 2]])


def _describe(solution: np.ndarray, sigmas: np.ndarray, robot: RobotModel) -> Tuple[CalibratedValue, ...]:
    yaw, pitch, roll = Rotation.from_matrix(robot.T_base_camera[:3, :3]).as_euler("ZYX")
    nominal = np.array([roll, pitch, yaw, *robot.T_base_camera[:2, 3], robot.camera_time_offset_s, 0.0, 0.0])
    ratio = robot.wheel_radius_m[1] / robot.wheel_radius_m[0]
    yaw_excited = math.degrees(sigmas[2]) < PARAMETERS[2][3]
    values = []
    for (name, unit, _, limit), value, sigma, before in zip(PARAMETERS, solution, sigmas, nominal):
        excited = (math.degrees(sigma) if unit == "deg" else sigma) < limit
        if name in ("camera x", "camera y"):  # by turns alone their direction goes with the yaw
            excited = excited and yaw_excited
        if unit == "deg":
            value, sigma, before = (math.degrees(angle) for angle in (value, sigma, before))
        elif name.startswith("wheel"):  # logarithms relative to nominal
            before = ratio if "ratio" in name else robot.wheel_base_m
            value, sigma = before * math.exp(value), before * sigma
        values.append(CalibratedValue(name, unit, float(value), float(sigma), float(before), bool(excited)))
    return tuple(values)


def _apply(values: Sequence[CalibratedValue], robot: RobotModel) -> RobotModel:
    roll, pitch, yaw, x, y, offset_s, ratio, base = (v.value if v.excited else v.nominal for v in values)
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("ZYX", [yaw, pitch, roll], degrees=True).as_matrix()
    T[:3, 3] = x, y, robot.T_base_camera[2, 3]
    mean = math.sqrt(robot.wheel_radius_m[0] * robot.wheel_radius_m[1])
    radii = (mean / math.sqrt(ratio), mean * math.sqrt(ratio))
    return replace(robot, T_base_camera=T, wheel_base_m=base, wheel_radius_m=radii, camera_time_offset_s=offset_s)
