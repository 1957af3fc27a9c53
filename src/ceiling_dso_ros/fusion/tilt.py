# SPDX-License-Identifier: BSD-3-Clause
"""How the robot is tilted against the plane in which it drives, at each keyframe, as its camera shows it.

The normal of the plane is n = (t_x, t_y, 1) in base_link, for small t; zero if the robot stands upright and the mount
of its camera is right. From node to node the visual odometry sees a turn by yaw, a tilt d, a shift s along x and y and
a climb c along z (see `VisualMotion`; one of its units is f metres). With that, t and the height h of the camera above
its mean height go on as

    t' = R(-yaw) (t - d),    h' = h + f (c + t . s).

A plane in the world, such as a map that leans, turns against base_link with the yaw. The error m of the mount does not:

    t = m + shaking,    h = lever . (t - m) + unevenness of the floor.

All of this is linear: a Kalman filter of x = (t, m, h), and a Rauch-Tung-Striebel smoother back from the newest node.
The variance of the shaking is learned from how far t - m is from where it was expected: a robot on rubber wheels shakes
by a tenth of a degree, one on a bad floor by several times that.
"""

from typing import Dict, List, NamedTuple, Sequence, Tuple

import numpy as np

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.config import VisualConfig
from ceiling_dso_ros.fusion.graph import Interval
from ceiling_dso_ros.fusion.visual import VisualMotion

MOUNT_SIGMA_RAD = 5e-3  # 0.3 degrees; calibrated mounts are better, and turns tell of one that is much worse
MOUNT_WALK_RAD = 5e-5  # from node to node: a load bends the robot
SHAKING_RAD = 2e-3  # first guess: a tenth of a degree
GUESS_WEIGHT = 10.0  # of that guess, in nodes
MEMORY = 100.0  # nodes from which the shaking is learned
LEAST_SHAKING_RAD = 2e-4
UNEVENNESS_M = 2e-3  # half of the 4 mm in a metre within which the floor of a building is level (DIN 18202)
OUTLIER = 3.0  # sigmas, beyond which shaking counts less (Huber): the robot drives over a cable

T, M, H = slice(0, 2), slice(2, 4), 4  # of x


class Tilt(NamedTuple):
    """Tilt of base_link against the plane of motion.

    Attributes:
        angles: (2,) roll and pitch, rad: base_link is the upright frame turned by Ry(pitch) Rx(roll).
        sigmas: (2,) their standard deviations, rad.
    """

    angles: np.ndarray
    sigmas: np.ndarray


def upright_rotation(angles: np.ndarray) -> np.ndarray:
    """R_upright_base = Ry(pitch) Rx(roll), (3, 3), of (2,) roll and pitch, rad; its z is the normal of the plane."""
    (sr, sp), (cr, cp) = np.sin(angles), np.cos(angles)
    return np.array([[cp, sp * sr, sp * cr], [0.0, cr, -sr], [-sp, cp * sr, cp * cr]])


class _State(NamedTuple):
    """Gaussian of x at a node: (5,) mean and (5, 5) covariance."""

    node: int
    mean: np.ndarray
    covariance: np.ndarray

    @property
    def tilt(self) -> Tilt:
        """The third row of R_upright_base is n."""
        (x, y), (var_x, var_y) = self.mean[T], self.covariance.diagonal()[T]
        return Tilt(np.array([y, -x]), np.sqrt([var_y, var_x]))


class _Step(NamedTuple):
    """A step of the filter: what was predicted by a (5, 5) transition, and the state after what is known of it."""

    transition: np.ndarray
    predicted: _State
    state: _State


class TiltFilter:
    """Follows the tilt along the intervals of the graph.

    Args:
        config: the errors of the odometry.
    """

    def __init__(self, config: VisualConfig) -> None:
        self._config = config
        self._settled = _State(0, np.zeros(5), np.diag([0.0, 0.0, MOUNT_SIGMA_RAD, MOUNT_SIGMA_RAD, 0.0]) ** 2)
        self._squares, self._weight = GUESS_WEIGHT * SHAKING_RAD**2, GUESS_WEIGHT

    @property
    def shaking_rad(self) -> float:
        """Standard deviation of roll and of pitch while driving, as far as it is known by now."""
        return max(LEAST_SHAKING_RAD, float(np.sqrt(max(self._squares / self._weight, 0.0))))

    def settle(self, interval: Interval, metres_per_unit: float) -> None:
        """Take in the oldest interval of the graph for good: it will be gone when there is a new node."""
        if interval.end <= self._settled.node:
            return
        step = self._step(self._settled, interval, metres_per_unit)
        if interval.visual is not None:
            self._learn(step.predicted)
        self._settled = step.state

    def smoothed(self, intervals: Sequence[Interval], metres_per_unit: Sequence[float]) -> Dict[int, Tilt]:
        """The tilts by node, from the one that was settled last.

        Args:
            intervals: those of the graph.
            metres_per_unit: at the end of each.
        """
        steps: List[_Step] = []
        state = first = self._settled
        for interval, scale in zip(intervals, metres_per_unit):
            if interval.end > first.node:
                steps.append(self._step(state, interval, scale))
                state = steps[-1].state
        result = {state.node: state.tilt}
        for before, after in zip(reversed([first, *(step.state for step in steps[:-1])]), reversed(steps)):
            state = _smoothed(before, after, state)
            result[state.node] = state.tilt
        return result

    def _step(self, before: _State, interval: Interval, metres_per_unit: float) -> _Step:
        visual = interval.visual if interval.end == before.node + 1 else None
        if visual is None:
            transition, noise = self._blind()
        else:
            transition, noise = self._seen(visual, metres_per_unit)
        mean = transition @ before.mean
        if visual is not None:
            mean[T] -= planar.rotation(-visual.yaw) @ visual.tilt
            mean[H] += metres_per_unit * visual.climb
        predicted = _State(interval.end, mean, transition @ before.covariance @ transition.T + np.diag(noise))
        # What is known of a robot that was not seen is in the prediction.
        return _Step(transition, predicted, predicted if visual is None else self._upright(predicted, visual.lever_m))

    def _seen(self, visual: VisualMotion, metres_per_unit: float) -> Tuple[np.ndarray, np.ndarray]:
        """(5, 5) transition and the (5,) variances of its noise."""
        transition = np.eye(5)
        transition[T, T] = planar.rotation(-visual.yaw)
        transition[H, T] = metres_per_unit * visual.shift
        turn, climb = self._config.yaw_sigma_rad, metres_per_unit * self._config.translation_sigma
        return transition, np.array([turn, turn, MOUNT_WALK_RAD, MOUNT_WALK_RAD, climb]) ** 2

    def _blind(self) -> Tuple[np.ndarray, np.ndarray]:
        """The same where the camera saw nothing: t = m + shaking, and the camera is as high as ever."""
        transition = np.zeros((5, 5))
        transition[T, M] = transition[M, M] = np.eye(2)
        shaking = self.shaking_rad
        return transition, np.array([shaking, shaking, MOUNT_WALK_RAD, MOUNT_WALK_RAD, UNEVENNESS_M]) ** 2

    def _upright(self, state: _State, lever_m: np.ndarray) -> _State:
        """After t - m = 0 up to shaking, and h - lever . (t - m) = 0 up to the floor's unevenness."""
        shaking = np.eye(3, 5) - np.eye(3, 5, 2)
        shaking[2] = [-lever_m[0], -lever_m[1], lever_m[0], lever_m[1], 1.0]
        error = -shaking @ state.mean
        total = shaking @ state.covariance @ shaking.T
        variance = self.shaking_rad**2
        variance *= max(1.0, _sigmas(error[:2], total[:2, :2] + variance * np.eye(2)) / OUTLIER)
        total += np.diag([variance, variance, UNEVENNESS_M**2])
        gain = np.linalg.solve(total, shaking @ state.covariance).T
        covariance = state.covariance - gain @ total @ gain.T
        return _State(state.node, state.mean + gain @ error, 0.5 * (covariance + covariance.T))

    def _learn(self, predicted: _State) -> None:
        """Learn the shaking: the square of t - m has the variance of the prediction, too, and weighs less for it."""
        P = predicted.covariance
        expected = 0.5 * float(np.trace(P[T, T] - P[T, M] - P[M, T] + P[M, M]))
        error = predicted.mean[T] - predicted.mean[M]
        variance = self.shaking_rad**2
        weight = (variance / (variance + expected)) ** 2
        square = 0.5 * float(error @ error)
        square /= max(1.0, np.sqrt(square / (variance + expected)) / OUTLIER)
        kept = max(0.0, 1.0 - weight / MEMORY)
        self._squares = kept * self._squares + weight * (square - expected)
        self._weight = kept * self._weight + weight


def _sigmas(error: np.ndarray, covariance: np.ndarray) -> float:
    """Mahalanobis distance of (2,) from zero."""
    return float(np.sqrt(error @ planar.inverse_2x2(covariance) @ error))


def _smoothed(filtered: _State, step: _Step, after: _State) -> _State:
    """The state before a step, given the smoothed one after it."""
    gain = np.linalg.solve(step.predicted.covariance, step.transition @ filtered.covariance).T
    mean = filtered.mean + gain @ (after.mean - step.predicted.mean)
    covariance = filtered.covariance + gain @ (after.covariance - step.predicted.covariance) @ gain.T
    return _State(filtered.node, mean, 0.5 * (covariance + covariance.T))
