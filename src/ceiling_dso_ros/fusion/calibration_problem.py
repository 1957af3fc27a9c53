# SPDX-License-Identifier: BSD-3-Clause
"""The least-squares problem of a calibration: residuals, initial guess in closed form, solution."""

import math
from dataclasses import dataclass
from typing import Sequence, Tuple

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.dso.compute.scatter import median_scatter
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.calibration_data import LARGEST_OFFSET_S, ImagePair, WheelPath
from ceiling_dso_ros.fusion.config import RobotModel

# standard deviations of the priors about the nominal values: roll, pitch, yaw, x, y, time offset, ln ratio, ln base
PRIOR_SIGMAS = np.array([*np.radians([20.0, 20.0, 180.0]), 1.0, 1.0, 0.1, 0.1, 0.1])
SCALE_PRIOR = (math.log(4.0), 1.0)  # metres per unit: logarithm and its standard deviation
FIRST_SIGMAS = np.array([1e-3, 2e-3, 2e-3, 5e-4, 5e-4, 5e-4])  # of a pair's residuals


def first_guess(wheels: WheelPath, pairs: Sequence[ImagePair], robot: RobotModel) -> np.ndarray:
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
    length = float(np.linalg.norm(sideways))
    return Rotation.from_rotvec(math.atan2(length, axis[2]) * sideways / max(length, 1e-12)).as_matrix()


def _first_translation(
    R: np.ndarray, motions: np.ndarray, pairs: Sequence[ImagePair], robot: RobotModel
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
    weak = np.zeros((2, 2 * len(segments) + 2))  # undetermined x and y stay at their nominal values
    weak[:, -2:] = 0.02 * np.eye(2)
    solution = np.linalg.lstsq(
        np.vstack([*rows, weak]), np.concatenate([*rhs, 0.02 * robot.T_base_camera[:2, 3]]), rcond=None
    )[0]
    turns = solution[:-2].reshape(-1, 2)
    if np.linalg.norm(turns, axis=1).min() < 0.1:  # hardly any distance: only turns on the spot
        return 0.0, robot.T_base_camera[:2, 3], np.full(len(segments), SCALE_PRIOR[0])
    weights = np.array([sum(pair.segment == segment for pair in pairs) for segment in segments])
    direction = (weights[:, None] * turns / np.linalg.norm(turns, axis=1, keepdims=True)).sum(axis=0)
    return math.atan2(direction[1], direction[0]), solution[-2:], np.log(np.linalg.norm(turns, axis=1))


@dataclass(frozen=True)
class Solution:
    """What fits the pairs best.

    Attributes:
        values: (8,) in the order of PRIOR_SIGMAS: rad, m, s and logarithms.
        covariance: (8, 8) of them.
        guess: the same with the scales, as `first_guess` gives it.
        forward: (n, 2) motion of the base along its arc in each pair: by the wheels in metres, by the camera in units.
        excess_m: (n, 3) for each pair, also for those that were not used: how much further than the camera says the
            left and the right wheel turned, and how much further to the left the robot moved by the wheels, metres.
    """

    values: np.ndarray
    covariance: np.ndarray
    guess: np.ndarray
    forward: np.ndarray
    excess_m: np.ndarray


class MountingProblem:
    """Residuals of all pairs, six each: yaw, tilt (2), and in units of the visual odometry x, y and climb.

    They are in VO units, because in metres the camera's noise would bias the scale downward.
    """

    def __init__(self, wheels: WheelPath, pairs: Sequence[ImagePair], robot: RobotModel) -> None:
        self._wheels = wheels
        self._wheel_base_m = robot.wheel_base_m
        self._pairs = pairs
        self._height_m = robot.T_base_camera[2, 3]
        self._rotations = np.array([pair.rotation for pair in pairs])
        self._translations = np.array([pair.translation for pair in pairs])
        segments = sorted({pair.segment for pair in pairs})
        self._segment = np.array([segments.index(pair.segment) for pair in pairs])
        R_nominal = Rotation.from_matrix(robot.T_base_camera[:3, :3])
        self._nominal = (R_nominal, robot.T_base_camera[:2, 3], robot.camera_time_offset_s)
        self._sigmas = FIRST_SIGMAS

    def solve(self, guess: np.ndarray, used: np.ndarray) -> Solution:
        """Fit those of the pairs that are used, (n,) bool, beginning with a guess as `first_guess` gives it."""
        self._used = used
        self._R = Rotation.from_rotvec(guess[:3])
        parameters = np.concatenate([np.zeros(3), guess[3:]])
        for loss in ("soft_l1", "cauchy", "cauchy"):  # in the end a slip has hardly any influence
            found = least_squares(self._weighted, parameters, loss=loss, f_scale=3.0, x_scale="jac")
            parameters = found.x
            residuals = self._residuals(parameters)[used]
            scatter = median_scatter(residuals, axis=0)
            self._sigmas = np.maximum(scatter, 1e-6)
        covariance = np.linalg.inv(found.jac.T @ found.jac)[: len(PRIOR_SIGMAS), : len(PRIOR_SIGMAS)]
        to_angles = np.eye(len(PRIOR_SIGMAS))
        angles = self._angles(parameters[:3])
        for axis, step in enumerate(1e-6 * np.eye(3)):
            to_angles[:3, axis] = (self._angles(parameters[:3] + step) - angles) / 1e-6
        return Solution(
            np.concatenate([angles, parameters[3:8]]),
            to_angles @ covariance @ to_angles.T,
            np.concatenate([(Rotation.from_rotvec(parameters[:3]) * self._R).as_rotvec(), parameters[3:]]),
            self._forward(parameters),
            self._excess_m(parameters),
        )

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
        residuals = self._residuals(parameters)[self._used]
        return np.concatenate([(residuals / self._sigmas).ravel(), prior, scale])

    def _residuals(self, parameters: np.ndarray) -> np.ndarray:
        yaw, tilt, seen = self._seen(parameters)
        units_per_m = np.exp(-parameters[8:])[self._segment]
        x, y, phi = self._wheels.motions(self._pairs, *parameters[5:8]).T
        phi = np.ascontiguousarray(phi)  # or the last bit depends on its place in memory
        moved = np.column_stack([x, y]) + _swing(phi, parameters[3:5]) + self._height_m * tilt
        shift = seen[:, :2] - units_per_m[:, None] * moved
        return np.column_stack([np.angle(np.exp(1j * (yaw - phi))), tilt, shift, seen[:, 2]])

    def _seen(self, parameters: np.ndarray) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Yaw (n,) and tilt (n, 2) of the base, and motion (n, 3) of the camera in VO units, all in the base's axes."""
        R = (Rotation.from_rotvec(parameters[:3]) * self._R).as_matrix()
        turned = R @ self._rotations @ R.T
        yaw = np.arctan2(turned[:, 1, 0] - turned[:, 0, 1], turned[:, 0, 0] + turned[:, 1, 1])
        return yaw, turned[:, :2, 2], self._translations @ R.T

    def _arcs(self, parameters: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Motions of the base by wheels and camera, (n, 3) each: forward and left along an arc in metres, turn."""
        yaw, tilt, seen = self._seen(parameters)
        m_per_unit = np.exp(parameters[8:])[self._segment]
        moved = m_per_unit[:, None] * seen[:, :2] - _swing(yaw, parameters[3:5]) - self._height_m * tilt
        by_wheels = self._wheels.motions(self._pairs, *parameters[5:8])
        by_camera = np.column_stack([moved, yaw])
        return np.array(list(map(planar.logmap, by_wheels))), np.array(list(map(planar.logmap, by_camera)))

    def _forward(self, parameters: np.ndarray) -> np.ndarray:
        by_wheels, by_camera = self._arcs(parameters)
        units_per_m = np.exp(-parameters[8:])[self._segment]
        return np.column_stack([by_wheels[:, 0], by_camera[:, 0] * units_per_m])

    def _excess_m(self, parameters: np.ndarray) -> np.ndarray:
        by_wheels, by_camera = self._arcs(parameters)
        forward, left, turn = (by_wheels - by_camera).T
        half = 0.5 * self._wheel_base_m * math.exp(parameters[7]) * turn
        return np.column_stack([forward - half, forward + half, left])


def _swing(yaw: np.ndarray, lever: np.ndarray) -> np.ndarray:
    """(n, 2) motion of the camera that turns of the base (n,) alone make, with its position (2,) in the base."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.column_stack([(c - 1.0) * lever[0] - s * lever[1], s * lever[0] + (c - 1.0) * lever[1]])
