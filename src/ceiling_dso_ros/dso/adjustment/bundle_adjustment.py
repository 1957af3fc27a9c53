# SPDX-License-Identifier: BSD-3-Clause
"""Windowed photometric bundle adjustment: Gauss-Newton over poses, brightness, intrinsics and inverse depths."""

from typing import Tuple

import numpy as np

from ceiling_dso_ros.dso.adjustment.linearization import Linearization
from ceiling_dso_ros.dso.adjustment.planar_motion import add_planar_motion
from ceiling_dso_ros.dso.compute.linear_solver import invert_positive, solve_positive
from ceiling_dso_ros.dso.config import OptimizationConfig
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.window.keyframe_window import FRAME_PARAMETERS, INTRINSICS, KeyframeWindow
from ceiling_dso_ros.dso.window.points import INLIER, NONE, PointTable

DAMPING = 1e-5
PRECONDITIONER = 10.0
# RMS steps below which the iterations end: translation (times mean inverse depth), rotation, a, b.
MIN_STEP = np.array([1e-4, 1e-4, 6e-3, 0.2])


def affine_prior(window: KeyframeWindow, information: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """Diagonal and gradient of the prior that pulls every keyframe's (a, b) to zero, each (4 + 8 n,) float64."""
    n = window.count
    diagonal = np.zeros(INTRINSICS + FRAME_PARAMETERS * n)
    gradient = np.zeros_like(diagonal)
    blocks = slice(INTRINSICS, None)
    diagonal[blocks].reshape(n, FRAME_PARAMETERS)[:, 6:] = information
    gradient[blocks].reshape(n, FRAME_PARAMETERS)[:, 6:] = information * window.keyframes.affine[:n]
    return diagonal, gradient


def null_space(window: KeyframeWindow) -> np.ndarray:
    """Orthonormal basis, (4 + 8 n, 7) float64, of what images leave undetermined: world pose and unit of length."""
    n = window.count
    basis = np.zeros((INTRINSICS + FRAME_PARAMETERS * n, 7))
    for slot in range(n):
        T = window.keyframes.T_camera_world_eval[slot]
        first = INTRINSICS + FRAME_PARAMETERS * slot
        R, t = T[:3, :3], T[:3, 3]
        basis[first : first + 3, :3] = R
        basis[first : first + 3, 3:6] = np.cross(t[:, None], R, axis=0)
        basis[first + 3 : first + 6, 3:6] = R
        basis[first : first + 3, 6] = t
    U, singular, _ = np.linalg.svd(basis, full_matrices=False)
    return U[:, singular > 1e-6 * singular[0]]


def unit_direction(window: KeyframeWindow) -> np.ndarray:
    """How the keyframes move when the unit of length changes and the oldest stays, (4 + 8 n, 1) float64, length 1."""
    n = window.count
    T = window.keyframes.T_camera_world_eval[:n]
    centre = se3.inverse(T[0])[:3, 3]
    steps = np.zeros((n, FRAME_PARAMETERS))
    steps[:, :3] = T[:, :3, :3] @ centre + T[:, :3, 3]
    direction = np.concatenate([np.zeros(INTRINSICS), steps.ravel()])
    return (direction / max(np.linalg.norm(direction), 1e-12))[:, None]


def unseen(window: KeyframeWindow, first: bool) -> np.ndarray:
    """Directions to remove from a step, (4 + 8 n, m) float64: in general all that images do not determine.

    In a first step it is only the unit of length, and only while the prior is diagonal: before a point is marginalised,
    nothing determines the unit, and rounding errors alone would change it.
    """
    if not first:
        return null_space(window)
    prior = window.prior.H
    if np.array_equal(prior, np.diag(np.diag(prior))):
        return unit_direction(window)
    return np.zeros((len(prior), 0))


def solve(H: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Step x of H x = -b for H symmetric positive semi-definite (n, n) float64; scales its diagonal to about one.

    Where there is no information, as along a change of the unit of length, rounding may make a diagonal entry negative.
    There is no step in such a direction.

    The Cholesky factorisation is our own: for the size of a window it is as fast as LAPACK, and its result does not
    depend on the number of threads.
    """
    scale = 1.0 / np.sqrt(np.maximum(np.diag(H), 0.0) + PRECONDITIONER)
    scaled = scale[:, None] * H * scale
    scaled[np.diag_indices_from(scaled)] *= 1.0 + DAMPING
    return -scale * solve_positive(scaled, scale * b)


class BundleAdjustment:
    """Refines a window. It holds scratch memory only; the estimate is part of the window."""

    def __init__(self, window: KeyframeWindow, config: OptimizationConfig) -> None:
        self.config = config
        slots = window.keyframes.offset.shape[0]
        self.linearization = Linearization(slots, window.points.capacity)
        self._leaving = PointTable(slots, window.points.capacity)
        self.affine_information = np.array([config.affine_a_information, config.affine_b_information])

    def optimize(self, window: KeyframeWindow) -> float:
        """Refine the window; removes residuals that end as outliers or outside.

        Returns the RMSE in grey levels, nan when no residual constrains the newest keyframe any more.
        """
        iterations = self.config.iterations if window.count >= 4 else self.config.first_iterations
        window.relinearize(window.newest)
        for iteration in range(iterations):
            self.linearization.update(window, window.points)
            self._set_threshold(window)
            step = self._step(window, unseen(window, first=iteration == 0))
            idepth_step = self.linearization.idepth_steps(window, step)
            window.move(step)
            window.points.arrays.idepth[: window.points.count] += idepth_step
            if self._converged(window, step):
                break
        self.linearization.assess(window, window.points)
        self._set_threshold(window)
        self._settle(window)
        if not np.isfinite(window.keyframes.T_camera_world[: window.count]).all():
            return float("nan")
        window.relinearize(window.newest)
        if not window.points.residuals.live[window.newest, : window.points.count].any():
            return float("nan")
        return float(np.sqrt(self.linearization.energy / max(8 * self.linearization.count, 1)))

    def marginalize_points(self, window: KeyframeWindow, leaving: np.ndarray) -> None:
        """Turn the residuals of points, (count,) bool, into a part of the window's prior."""
        self._leaving.copy_from(window.points, leaving)
        self.linearization.update(window, self._leaving)
        weight = self.config.marginalization_weight
        H, b = self.linearization.H, self.linearization.b
        window.prior.H[:] += weight * H
        window.prior.b[:] += weight * (b - H @ window.offsets)

    @staticmethod
    def _set_threshold(window: KeyframeWindow) -> None:
        """Residuals into the newest keyframe are outliers above a threshold that follows their energies."""
        newest = window.newest
        count = window.points.count
        live = window.points.residuals.live[newest, :count] > 0
        energies = window.points.residuals.energy[newest, :count][live]
        if energies.size:
            rank = int(0.7 * energies.size)
            quantile = np.sqrt(np.partition(energies, rank)[rank])
            window.keyframes.energy_threshold[newest] = (0.5 * 26.0 + 0.5 * 1.5 * quantile) ** 2

    def _step(self, window: KeyframeWindow, directions: np.ndarray) -> np.ndarray:
        """Step of (intrinsics, keyframes) without its share along orthonormal directions, (4 + 8 n, m)."""
        diagonal, gradient = affine_prior(window, self.affine_information)
        H = self.linearization.H + window.prior.H
        H[np.diag_indices_from(H)] += diagonal
        b = self.linearization.b + window.prior.b + window.prior.H @ window.offsets + gradient
        if window.normal is not None:
            poses = window.keyframes.T_camera_world[: window.count]
            add_planar_motion(window.normal, poses, INTRINSICS, FRAME_PARAMETERS, H, b)
        step = solve(H, b)
        return step - directions @ (directions.T @ step)

    @staticmethod
    def _converged(window: KeyframeWindow, step: np.ndarray) -> bool:
        frames = step[INTRINSICS:].reshape(window.count, FRAME_PARAMETERS)
        mean_idepth = float(np.mean(window.points.arrays.idepth[: window.points.count]))
        rms = np.sqrt(np.mean(frames * frames, axis=0))
        sizes = [rms[:3].max() * mean_idepth, rms[3:6].max(), rms[6], rms[7]]
        return bool(np.all(sizes < MIN_STEP))

    @staticmethod
    def _settle(window: KeyframeWindow) -> None:
        """Keep inliers only."""
        count = window.points.count
        residuals = window.points.residuals
        live = residuals.live[:, :count]
        live &= residuals.state[:, :count] == INLIER
        residuals.state[:, :count][(live == 0) & (residuals.state[:, :count] == INLIER)] = NONE
        good = window.points.arrays.good_residuals[:count]
        good += np.where(good == 0, live.sum(axis=0, dtype=np.int64), live[window.newest])


def marginalize_keyframe(window: KeyframeWindow, slot: int, affine_information: np.ndarray) -> None:
    """Eliminate a keyframe from the prior by Schur complement and remove it from the window."""
    diagonal, gradient = affine_prior(window, affine_information)
    first = INTRINSICS + FRAME_PARAMETERS * slot
    block = np.arange(first, first + FRAME_PARAMETERS)
    rest = np.setdiff1d(np.arange(window.prior.b.size), block)
    H, b = window.prior.H.copy(), window.prior.b.copy()
    H[block, block] += diagonal[block]
    b[block] += gradient[block] - diagonal[block] * window.offsets[block]
    scale = 1.0 / np.sqrt(np.maximum(np.diag(H)[block], 0.0) + PRECONDITIONER)
    inverse = scale[:, None] * invert_positive(scale[:, None] * H[np.ix_(block, block)] * scale) * scale
    gain = H[np.ix_(rest, block)] @ inverse
    reduced = H[np.ix_(rest, rest)] - gain @ H[np.ix_(block, rest)]
    window.remove_keyframe(slot)
    window.prior = type(window.prior)(0.5 * (reduced + reduced.T), b[rest] - gain @ b[block])
