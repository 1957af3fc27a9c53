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

How much a robot shakes depends on its wheels and floor. How much the odometry errs depends on the ceiling: a faint one
may let it lean by a milliradian a step, always to the same side. So filters with several such noises run side by side
as interacting multiple models, and the most probable one is smoothed: the more the odometry errs, the more it holds to
t = m. The models interact where an interval is settled: one that was wrong begins anew from those that were right.
"""

from typing import Dict, List, NamedTuple, Sequence

import numpy as np

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.config import VisualConfig
from ceiling_dso_ros.fusion.graph import Interval
from ceiling_dso_ros.fusion.visual import VisualMotion

MOUNT_SIGMA_RAD = 2.5e-3  # 0.15 degrees: five times what `calibrate` is wrong by; turns tell of a mount that is worse
MOUNT_WALK_RAD = 5e-5  # from node to node: a load bends the robot
UNEVENNESS_M = 2e-3  # half of the 4 mm in a metre within which the floor of a building is level (DIN 18202)
OUTLIER = 3.0  # sigmas, beyond which shaking counts less (Huber): the robot drives over a cable
# The noises of the models: shaking (rad, of roll and of pitch), and the odometry's errors in units of those of
# `VisualConfig`. At first those that differ by one step from the usual ones are one sigma away.
SHAKING_RAD = 2e-3
SHAKINGS_RAD = SHAKING_RAD * 2.0 ** np.arange(-2, 3)
ERRORS = 4.0 ** np.arange(3)
CHANGES = 1.0 / 40.0  # how often the noise changes, of all nodes: after ten metres, under another part of the ceiling

LONGEST_STEP_M = 100.0  # a step beyond it is no motion between two keyframes, and its errors would drown all numbers

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


class _States(NamedTuple):
    """Gaussians of x at a node, of N filters.

    Attributes:
        node: the node.
        mean: (N, 5).
        covariance: (N, 5, 5).
        score: (N,) logarithm of the probability of each filter, up to a constant.
    """

    node: int
    mean: np.ndarray
    covariance: np.ndarray
    score: np.ndarray


class _Step(NamedTuple):
    """A step of the filters: what a (5, 5) transition has predicted, and the states after what is known of the node."""

    transition: np.ndarray
    predicted: _States
    states: _States


class TiltFilter:
    """Follows the tilt along the intervals of the graph.

    Args:
        config: the errors of the odometry.
    """

    def __init__(self, config: VisualConfig) -> None:
        self._config = config
        shaking, errors = (axis.ravel() for axis in np.meshgrid(SHAKINGS_RAD, ERRORS))
        self._shaking, self._errors = shaking, errors  # (N,) of each filter
        count = len(shaking)
        mount = np.diag([0.0, 0.0, MOUNT_SIGMA_RAD, MOUNT_SIGMA_RAD, 0.0]) ** 2
        likely = -0.5 * (np.log2(shaking / SHAKING_RAD) ** 2 + (0.5 * np.log2(errors)) ** 2)
        self._settled = _States(0, np.zeros((count, 5)), np.repeat(mount[None], count, axis=0), likely)

    @property
    def shaking_rad(self) -> float:
        """Standard deviation of roll and of pitch while driving that explains the nodes so far best."""
        return float(self._shaking[np.argmax(self._settled.score)])

    def settle(self, interval: Interval, metres_per_unit: float) -> None:
        """Take in the oldest interval of the graph for good: it will be gone when there is a new node."""
        if interval.end > self._settled.node:
            self._settled = self._step(_mixed(self._settled), interval, metres_per_unit).states

    def smoothed(self, intervals: Sequence[Interval], metres_per_unit: Sequence[float]) -> Dict[int, Tilt]:
        """The tilts by node, from the one that was settled last.

        Args:
            intervals: those of the graph.
            metres_per_unit: at the end of each.
        """
        steps: List[_Step] = []
        states = first = self._settled
        for interval, scale in zip(intervals, metres_per_unit):
            if interval.end > first.node:
                steps.append(self._step(states, interval, scale))
                states = steps[-1].states
        best = int(np.argmax(states.score))
        mean, covariance = states.mean[best], states.covariance[best]
        result = {states.node: _tilt(mean, covariance)}
        for before, after in zip(reversed([first, *(step.states for step in steps[:-1])]), reversed(steps)):
            predicted = after.predicted.covariance[best]
            gain = np.linalg.solve(predicted, after.transition @ before.covariance[best]).T
            mean = before.mean[best] + gain @ (mean - after.predicted.mean[best])
            covariance = before.covariance[best] + gain @ (covariance - predicted) @ gain.T
            result[before.node] = _tilt(mean, covariance)
        return result

    def _step(self, before: _States, interval: Interval, metres_per_unit: float) -> _Step:
        visual = interval.visual if interval.end == before.node + 1 else None
        if visual is not None and not _is_short(visual, metres_per_unit):
            visual = None
        transition = np.eye(5)
        noise = np.empty((len(before.mean), 5))
        noise[:, M] = MOUNT_WALK_RAD
        if visual is None:  # t = m + shaking, and the camera is as high as ever
            transition[T, T], transition[T, M], transition[H, H] = 0.0, np.eye(2), 0.0
            noise[:, T], noise[:, H] = self._shaking[:, None], UNEVENNESS_M
        else:
            transition[T, T] = planar.rotation(-visual.yaw)
            transition[H, T] = metres_per_unit * visual.shift
            noise[:, T] = self._errors[:, None] * self._config.yaw_sigma_rad
            noise[:, H] = self._errors * metres_per_unit * self._config.translation_sigma
        mean = before.mean @ transition.T
        covariance = transition @ before.covariance @ transition.T
        covariance[:, range(5), range(5)] += noise**2
        if visual is None:  # what is known of a robot that was not seen is in the prediction
            predicted = _States(interval.end, mean, covariance, before.score)
            return _Step(transition, predicted, predicted)
        mean[:, T] -= transition[T, T] @ visual.tilt
        mean[:, H] += metres_per_unit * visual.climb
        predicted = _States(interval.end, mean, covariance, before.score)
        return _Step(transition, predicted, self._upright(predicted, visual.lever_m))

    def _upright(self, states: _States, lever_m: np.ndarray) -> _States:
        """After t - m = 0 up to shaking, and h - lever . (t - m) = 0 up to the floor's unevenness."""
        measured = np.eye(3, 5) - np.eye(3, 5, 2)
        measured[2] = [-lever_m[0], -lever_m[1], lever_m[0], lever_m[1], 1.0]
        cross = states.covariance @ measured.T
        total = measured @ cross
        total[:, [0, 1], [0, 1]] += self._shaking[:, None] ** 2
        total[:, 2, 2] += UNEVENNESS_M**2
        error = -states.mean @ measured.T
        sigmas = np.sqrt(np.einsum("ni,nij,nj->n", error[:, :2], np.linalg.inv(total[:, :2, :2]), error[:, :2]))
        more = (np.maximum(sigmas / OUTLIER, 1.0) - 1.0) * self._shaking**2
        total[:, [0, 1], [0, 1]] += more[:, None]
        inverse = np.linalg.inv(total)
        gain = cross @ inverse
        covariance = states.covariance - gain @ cross.transpose(0, 2, 1)
        fit = np.einsum("ni,nij,nj->n", error, inverse, error) + np.log(np.linalg.det(total))
        return _States(
            states.node,
            states.mean + np.einsum("nij,nj->ni", gain, error),
            0.5 * (covariance + covariance.transpose(0, 2, 1)),
            states.score - 0.5 * fit,
        )


def _is_short(visual: VisualMotion, metres_per_unit: float) -> bool:
    return bool(metres_per_unit * np.linalg.norm([*visual.shift, visual.climb]) < LONGEST_STEP_M)


def _mixed(states: _States) -> _States:
    """What each filter begins with if another one may have been right up to here: the moments of the mixture."""
    count = len(states.score)
    probable = np.exp(states.score - states.score.max())
    switches = (1.0 - CHANGES) * np.eye(count) + CHANGES / count
    joint = probable[:, None] / probable.sum() * switches  # (from, to)
    probable = joint.sum(axis=0)
    share = joint / probable
    mean = share.T @ states.mean
    apart = states.mean[:, None] - mean
    covariance = np.einsum("ij,iab->jab", share, states.covariance) + np.einsum("ij,ija,ijb->jab", share, apart, apart)
    return _States(states.node, mean, covariance, np.log(probable))


def _tilt(mean: np.ndarray, covariance: np.ndarray) -> Tilt:
    """The tilt of (5,) x: the third row of R_upright_base is n."""
    (x, y), (var_x, var_y) = mean[T], covariance.diagonal()[T]
    return Tilt(np.array([y, -x]), np.sqrt([var_y, var_x]))
