# SPDX-License-Identifier: BSD-3-Clause
"""Solves the factor graph of a whole drive at once, for the smoothed trajectory.

Without loops the graph is a chain, and no factor knows an absolute pose but that of the origin. So the variables here
are the motions m_k from node to node: each is in the factors of its own interval alone. Intervals are connected only
by their log-scales l_k, each with the one before, and by the constants c and g of the whole drive (see `factors.py`).
Eliminating the m_k leaves a tridiagonal system of the l_k. The keyframes of an hour take about a second; gtsam would
call Python for each of them in each iteration.
"""

from dataclasses import dataclass
from typing import List, NamedTuple, Tuple

import numpy as np
from scipy.linalg import solveh_banded

from ceiling_dso_ros.fusion.config import FusionConfig
from ceiling_dso_ros.fusion.measured_scales import MeasuredScales

TOLERANCE = 1e-9  # metres, rad, logarithm: iterations end when no variable changes by more
CLOSE = 1e-3  # the same, below which outliers remain the same ones
MAX_ITERATIONS = 100  # of which about seven are needed
FIRST_DAMPING = 1e-4  # relative, after a step that made the error larger; each further one multiplies it by ten
LARGEST_DAMPING = 1e8  # beyond it no step helps: the solution is as good as the numbers allow
ROUNDING = 1e-12  # relative: smaller changes of the error are not told from rounding
# c: wheel ratio and wheel base (logarithms); g: yaw of the camera; zero unless they are estimated. A fourth one where a
# second camera has measured scales: n, see `metre`.
CONSTANTS = 3


@dataclass(frozen=True)
class SmoothedNode:
    """One keyframe of the whole graph's solution.

    Attributes:
        stamp_ns: on the wheels' clock.
        pose: (3,) of the base.
        log_scale: logarithm of metres per visual unit.
        step_covariance: (3, 3) of the motion from the node before, the scale and the constants taken as exact.
    """

    stamp_ns: int
    pose: np.ndarray
    log_scale: float
    step_covariance: np.ndarray


def smooth(motions: np.ndarray, config: FusionConfig) -> List[SmoothedNode]:
    """Solve the graph of a whole drive.

    Args:
        motions: (N,) MOTION, consecutive. The graph begins at the `start_pose` of the first one, with a new scale.
        config: the settings of the live estimate.

    Returns:
        The later node of each motion.

    Raises:
        ValueError: a measurement is not finite.
        numpy.linalg.LinAlgError: a covariance is not positive.
    """
    if not len(motions):
        return []
    chain = _Chain(motions, config)
    state = _solve(chain)
    x, y, start_yaw = motions["start_pose"][0]
    yaw = start_yaw + np.append(0.0, np.cumsum(state.motions[:, 2]))
    positions = np.array([x, y]) + np.cumsum(_turned(state.motions[:, :2], yaw[:-1]), axis=0)
    poses = np.column_stack([positions, _wrapped(yaw[1:])])
    return [
        SmoothedNode(stamp_ns, pose, log_scale, covariance)
        for stamp_ns, pose, log_scale, covariance in zip(
            motions["stamp_ns"].tolist(), poses, state.log_scales.tolist(), chain.step_covariances(state)
        )
    ]


def step_covariances(
    motions: np.ndarray, steps: np.ndarray, log_scales: np.ndarray, config: FusionConfig
) -> np.ndarray:
    """Covariances of the motions between the nodes of a solution, (N, 3, 3), as those of SmoothedNode.

    Args:
        motions: (N,) MOTION, consecutive.
        steps: (N, 3) motion of the base in each.
        log_scales: (N,) of the later nodes.
        config: the settings of the live estimate.
    """
    chain = _Chain(motions, config)
    return chain.step_covariances(_State(steps, log_scales, np.zeros(CONSTANTS)))


def _solve(chain: "_Chain") -> "_State":
    """Gauss-Newton, with damping (Levenberg-Marquardt) where a step makes the error larger.

    Outliers are weighted less, which converges from far away but slowly. Close to the solution, the curvature of the
    robust loss itself is used instead, Newton's method.
    """
    state = chain.guess()
    linear = chain.linearize(state)
    error, damping, largest = chain.error(linear, state), 0.0, np.inf
    for _ in range(MAX_ITERATIONS):
        step = chain.step(linear, state, damping, is_close=largest < CLOSE)
        ahead = state.moved(step)
        next_linear = chain.linearize(ahead)
        next_error = chain.error(next_linear, ahead)
        if next_error <= error * (1.0 + ROUNDING):  # false if it is not finite
            state, linear, error = ahead, next_linear, next_error
            largest = max(np.abs(change).max() for change in step)
            if largest < TOLERANCE:
                break
            damping = 0.1 * damping if damping > FIRST_DAMPING else 0.0
        else:
            damping = max(FIRST_DAMPING, 10.0 * damping)
            if damping > LARGEST_DAMPING:
                break
    return state


class _State(NamedTuple):
    """All variables, or a change of them: (N, 3) motions, (N,) log-scales, (3,) or (4,) constants."""

    motions: np.ndarray
    log_scales: np.ndarray
    constants: np.ndarray

    def moved(self, step: "_State") -> "_State":
        """After a step."""
        return _State(*(value + change for value, change in zip(self, step)))


class _Linear(NamedTuple):
    """Whitened residuals (N, 6) of wheels and camera, with their derivatives (N, 6, 7).

    Those are by the motion and the log-scale of their interval, and by the constants.
    """

    residuals: np.ndarray
    derivatives: np.ndarray


class _Chain:
    """The graph of (N,) MOTION."""

    def __init__(self, motions: np.ndarray, config: FusionConfig) -> None:
        self._motions = motions
        self._threshold = config.visual.robust_threshold
        wheels, yaw = config.wheels, config.graph.camera_yaw_sigma_rad
        self._prior_sigmas = np.array([wheels.ratio_sigma, wheels.base_sigma, yaw])
        self._whiten_wheels = np.linalg.inv(np.linalg.cholesky(motions["wheels_covariance"]))
        seen = motions["is_seen"]
        self._whiten_visual = np.zeros((len(motions), 3, 3))  # no residual where the camera saw nothing
        self._whiten_visual[seen] = np.linalg.inv(np.linalg.cholesky(motions["visual_covariance"][seen]))
        self._continues = motions["continues"].copy()
        self._continues[0] = False
        mean, sigma = motions["log_scale"].T
        self._scale_prior = mean
        self._scale_information = np.where(self._continues, motions["walk_sigma"], sigma) ** -2.0
        self._free = np.arange(CONSTANTS) if config.graph.estimate_wheels else np.zeros(0, np.int64)
        self._stereo = MeasuredScales(motions, config)
        if self._stereo:
            self._free = np.append(self._free, CONSTANTS)
            self._prior_sigmas = np.append(self._prior_sigmas, self._stereo.metre_sigma)

    def guess(self) -> _State:
        """The wheels' motions with the turns of the camera, which are more accurate and need no scale."""
        motions = self._motions["wheels"].copy()
        motions[:, 2] = np.where(self._motions["is_seen"], self._motions["yaw"], motions[:, 2])
        return _State(motions, self._scale_prior, np.zeros(len(self._prior_sigmas)))

    def linearize(self, state: _State) -> _Linear:
        """Residuals and derivatives at a state."""
        count = len(self._motions)
        linear = _Linear(np.zeros((count, 6)), np.zeros((count, 6, 4 + CONSTANTS)))
        self._add_wheels(linear, state)
        self._add_visual(linear, state)
        return linear

    def _add_wheels(self, linear: _Linear, state: _State) -> None:
        """As `factors.calibrated_wheel_factor`."""
        measured, by_constants = self._motions["wheels"], self._motions["by_constants"]
        correction = by_constants @ state.constants[:2]
        residual = np.empty((len(measured), 3))
        residual[:, :2] = _turned(state.motions[:, :2] - measured[:, :2], -measured[:, 2]) - correction[:, :2]
        residual[:, :2] = _turned(residual[:, :2], -correction[:, 2])
        residual[:, 2] = _wrapped(state.motions[:, 2] - measured[:, 2] - correction[:, 2])
        derivative = np.zeros((len(measured), 3, 4))
        derivative[:, :2, :2] = _rotations(-measured[:, 2] - correction[:, 2])
        derivative[:, 2, 2] = 1.0
        by_correction = np.zeros((len(measured), 3, 3))
        by_correction[:, :2, :2] = -_rotations(-correction[:, 2])
        by_correction[:, :2, 2] = -_quarter_turned(residual[:, :2])
        by_correction[:, 2, 2] = -1.0
        linear.residuals[:, :3] = np.einsum("nij,nj->ni", self._whiten_wheels, residual)
        linear.derivatives[:, :3, :4] = self._whiten_wheels @ derivative
        linear.derivatives[:, :3, 4:6] = self._whiten_wheels @ by_correction @ by_constants

    def _add_visual(self, linear: _Linear, state: _State) -> None:
        """As `factors.visual_factor`."""
        motions, yaw = self._motions, state.motions[:, 2]
        units = np.exp(-state.log_scales)[:, None]
        turned = _turned(motions["lever_m"], yaw)
        predicted = units * (state.motions[:, :2] + turned - motions["lever_m"] + motions["swing_m"])
        seen = _turned(motions["shift"], np.full(len(motions), state.constants[2]))
        residual = np.column_stack([seen - predicted, _wrapped(motions["yaw"] - yaw)])
        derivative = np.zeros((len(motions), 3, 7))
        derivative[:, 0, 0] = derivative[:, 1, 1] = -units[:, 0]
        derivative[:, :2, 2] = -units * _quarter_turned(turned)
        derivative[:, 2, 2] = -1.0
        derivative[:, :2, 3] = predicted
        derivative[:, :2, 6] = _quarter_turned(seen)
        linear.residuals[:, 3:] = np.einsum("nij,nj->ni", self._whiten_visual, residual)
        linear.derivatives[:, 3:] = self._whiten_visual @ derivative

    def _scale_residuals(self, state: _State) -> np.ndarray:
        """(N,) by which the log-scales differ from those before, or new ones from their prior; not whitened."""
        before = np.append(0.0, state.log_scales[:-1])
        return state.log_scales - np.where(self._continues, before, self._scale_prior)

    def error(self, linear: _Linear, state: _State) -> float:
        """Sum of squared residuals; of the camera's only their length counts beyond the threshold (Huber)."""
        lengths = np.linalg.norm(linear.residuals[:, 3:], axis=1)
        within = np.minimum(lengths, self._threshold)
        scales = self._scale_information * self._scale_residuals(state) ** 2
        priors = (state.constants / self._prior_sigmas) ** 2
        wheels = np.sum(linear.residuals[:, :3] ** 2)
        cameras = np.sum(within * (2.0 * lengths - within))
        if self._stereo:
            cameras += self._stereo.error(state.log_scales, state.constants[-1])
        return float(wheels + cameras + np.sum(scales) + np.sum(priors))

    def step(self, linear: _Linear, state: _State, damping: float, is_close: bool) -> _State:
        """The change that solves the normal equations."""
        gradient, information = self._normal_equations(linear, is_close)
        constants_gradient = state.constants / self._prior_sigmas**2
        constants_information = np.diag(self._prior_sigmas**-2.0)
        constants_gradient[:CONSTANTS] += gradient[:, 4:].sum(axis=0)
        constants_information[:CONSTANTS, :CONSTANTS] += information[:, 4:, 4:].sum(axis=0)
        # of an interval's own variables; to the right: the gradient, and what connects them with the constants
        own = information[:, :4, :4] * (1.0 + damping * np.eye(4))
        right = np.concatenate([gradient[:, :4, None], information[:, :4, 4:]], axis=2)

        motion_inverse = np.linalg.inv(own[:, :3, :3])
        to_scale = own[:, 3:, :3] @ motion_inverse
        scale_own = own[:, 3, 3] - (to_scale @ own[:, :3, 3:])[:, 0, 0]
        scale_right = (right[:, 3:] - to_scale @ right[:, :3])[:, 0]
        pull = self._scale_information * self._scale_residuals(state)
        walks = np.append(np.where(self._continues, self._scale_information, 0.0)[1:], 0.0)  # to the next one
        scale_own += (1.0 + damping) * (self._scale_information + walks)
        scale_right[:, 0] += pull - np.append(np.where(self._continues, pull, 0.0)[1:], 0.0)
        if self._stereo:
            pull, weights = self._stereo.pull(state.log_scales, state.constants[-1])
            scale_own += (1.0 + damping) * weights
            scale_right[:, 0] += pull
            constants_gradient[-1] -= pull.sum()
            constants_information[-1, -1] += weights.sum()
            scale_right = np.column_stack([scale_right, -weights])
            right = np.concatenate([right, np.zeros((len(right), 4, 1))], axis=2)
        solved = solveh_banded(np.array([scale_own, -walks]), scale_right, lower=True)

        constants, free = np.zeros(len(constants_gradient)), self._free
        if len(free):
            eliminated = np.einsum("nip,niq->pq", right[:, :3], motion_inverse @ right[:, :3]) + scale_right.T @ solved
            remaining = constants_information * (1.0 + damping * np.eye(len(constants))) - eliminated[1:, 1:]
            own_gradient = eliminated[1:, 0] - constants_gradient
            constants[free] = np.linalg.solve(remaining[np.ix_(free, free)], own_gradient[free])
        rest = np.append(1.0, constants)
        log_scales = -solved @ rest
        gradients = right[:, :3] @ rest + own[:, :3, 3] * log_scales[:, None]
        return _State(-np.einsum("nij,nj->ni", motion_inverse, gradients), log_scales, constants)

    def step_covariances(self, state: _State) -> np.ndarray:
        """(N, 3, 3) of the motions, seen from their ends."""
        _, information = self._normal_equations(self.linearize(state), is_close=False)
        to_end = np.zeros((len(information), 3, 3))
        to_end[:, :2, :2], to_end[:, 2, 2] = _rotations(-state.motions[:, 2]), 1.0
        return to_end @ np.linalg.inv(information[:, :3, :3]) @ to_end.transpose(0, 2, 1)

    def _normal_equations(self, linear: _Linear, is_close: bool) -> Tuple[np.ndarray, np.ndarray]:
        """Gradient (N, 7) and information (N, 7, 7) of wheels and camera in each interval."""
        lengths = np.linalg.norm(linear.residuals[:, 3:], axis=1)
        weights = np.ones((len(lengths), 6))
        weights[:, 3:] = (self._threshold / np.maximum(lengths, self._threshold))[:, None]
        transposed = linear.derivatives.transpose(0, 2, 1)
        gradient = np.einsum("nij,nj->ni", transposed, weights * linear.residuals)
        information = transposed @ (weights[:, :, None] * linear.derivatives)
        if is_close:  # the loss of an outlier grows linearly: along its residual it has no curvature
            far = np.flatnonzero(lengths > self._threshold)
            along = np.sqrt(weights[far, 3:]) * linear.residuals[far, 3:] / lengths[far, None]
            pull = np.einsum("nij,nj->ni", transposed[far][:, :, 3:], along)
            information[far] -= pull[:, :, None] * pull[:, None, :]
        return gradient, information


def _cos_sin(angles: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """Of (N,) angles. Where they are not contiguous, numpy's last bit depends on where they lie in memory."""
    angles = np.ascontiguousarray(angles)
    return np.cos(angles), np.sin(angles)


def _turned(vectors: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """(N, 2) vectors turned by (N,) angles."""
    cos, sin = _cos_sin(angles)
    x, y = vectors[:, 0], vectors[:, 1]
    return np.column_stack([cos * x - sin * y, sin * x + cos * y])


def _quarter_turned(vectors: np.ndarray) -> np.ndarray:
    """(N, 2) vectors turned by 90 degrees: the derivative of a turned one by the angle."""
    return np.column_stack([-vectors[:, 1], vectors[:, 0]])


def _rotations(angles: np.ndarray) -> np.ndarray:
    """(N, 2, 2)."""
    cos, sin = _cos_sin(angles)
    return np.stack([np.stack([cos, -sin], axis=-1), np.stack([sin, cos], axis=-1)], axis=-2)


def _wrapped(angles: np.ndarray) -> np.ndarray:
    """The same angles in (-pi, pi]."""
    return np.pi - (np.pi - angles) % (2.0 * np.pi)
