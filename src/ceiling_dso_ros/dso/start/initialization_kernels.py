# SPDX-License-Identifier: BSD-3-Clause
"""Kernels of the initialiser: joint alignment of one level's pose and inverse depths."""

import math

import numpy as np

from ceiling_dso_ros.dso.adjustment.linearization import Scratch, add_pair, sum_pair
from ceiling_dso_ros.dso.adjustment.residual_kernels import COLUMNS
from ceiling_dso_ros.dso.compute.jit import kernel
from ceiling_dso_ros.dso.compute.linear_solver import solve_positive
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.geometry.projection import intrinsic_inverse, intrinsic_matrix, pixel_warp
from ceiling_dso_ros.dso.tracking.tracking_kernels import step_size
from ceiling_dso_ros.dso.window.points import PointArrays, ResidualArrays

PARAMETERS = 8  # translation, rotation, gain (as a log), offset
FIRST = 4  # first pose column of a pair's system
MIN_STEP = 0.02  # pixels of the level, at the image's centre
MIN_IDEPTH, MAX_IDEPTH = np.float32(1e-3), np.float32(50.0)


@kernel
def linearize_level(
    points: PointArrays, residuals: ResidualArrays, count: int, image: np.ndarray, width: int, height: int,
    intrinsics: np.ndarray, T_frame_first: np.ndarray, brightness: np.ndarray, threshold: float, scratch: Scratch,
    system: np.ndarray,
) -> tuple:  # fmt: skip
    """Photometric normal equations of one level into system, (13, 13) float64; returns energy and points in view."""
    KRKi, Kt = pixel_warp(intrinsic_matrix(intrinsics), intrinsic_inverse(intrinsics), T_frame_first)
    energy, in_view = sum_pair(
        residuals.live[0, :count], 0, points, image, width, height, KRKi.astype(np.float32),
        Kt.astype(np.float32), np.float32(math.exp(brightness[0])), np.float32(brightness[1]), np.float32(0),
        np.float32(threshold), residuals.state[0, :count], residuals.energy[0, :count], scratch,
    )  # fmt: skip
    points.idepth_hessian[:count] = 0
    points.idepth_gradient[:count] = 0
    points.idepth_intrinsics[:, :count] = 0
    system[:] = 0.0
    add_pair(
        points, residuals.idepth_relative[0], 0, count, intrinsics.astype(np.float32),
        T_frame_first[:3, :3].astype(np.float32), T_frame_first[:3, 3].astype(np.float32), scratch, system,
    )  # fmt: skip
    return energy, in_view


@kernel
def regularization_energy(points: PointArrays, count: int, target: np.ndarray, weight: float) -> float:
    """Sum of weight (idepth - target)^2."""
    total = 0.0
    for i in range(count):
        difference = points.idepth[i] - target[i]
        total += weight * difference * difference
    return total


@kernel
def eliminate_idepths(
    points: PointArrays, idepth_relative: np.ndarray, count: int, target: np.ndarray, weight: float, damping: float,
    H: np.ndarray, b: np.ndarray,
) -> None:  # fmt: skip
    """Subtract the Schur complement of regularised inverse depths from H (8, 8) and b (8,)."""
    row = np.empty(PARAMETERS)
    for i in range(count):
        hessian = (points.idepth_hessian[i] + weight) * (1.0 + damping)
        gradient = points.idepth_gradient[i] + weight * (points.idepth[i] - target[i])
        inverse = 1.0 / hessian
        for c in range(PARAMETERS):
            row[c] = idepth_relative[c, i]
        for c in range(PARAMETERS):
            b[c] -= row[c] * inverse * gradient
            for d in range(c + 1):
                H[c, d] -= row[c] * inverse * row[d]


@kernel
def step_idepths(
    points: PointArrays, idepth_relative: np.ndarray, count: int, target: np.ndarray, weight: float, damping: float,
    step: np.ndarray,
) -> None:  # fmt: skip
    """Back substitution: move the inverse depths by their step."""
    for i in range(count):
        hessian = (points.idepth_hessian[i] + weight) * (1.0 + damping)
        gradient = points.idepth_gradient[i] + weight * (points.idepth[i] - target[i])
        for c in range(PARAMETERS):
            gradient += idepth_relative[c, i] * step[c]
        idepth = points.idepth[i] - np.float32(gradient / hessian)
        points.idepth[i] = min(max(idepth, MIN_IDEPTH), MAX_IDEPTH)


@kernel
def align_level(
    points: PointArrays, residuals: ResidualArrays, count: int, image: np.ndarray, width: int, height: int,
    intrinsics: np.ndarray, T_frame_first: np.ndarray, brightness: np.ndarray,
    translation_information: float, target: np.ndarray, weight: float, threshold: float, max_iterations: int,
    scratch: Scratch,
) -> tuple:  # fmt: skip
    """Levenberg-Marquardt for pose, brightness and inverse depths of one level.

    Args:
        points: of the first frame on this level; idepth is updated.
        residuals: one target, the new frame.
        T_frame_first, brightness: start; brightness is (ln gain, offset) from the first frame to the new one.
        translation_information: per point, pulls the translation to zero.
        target, weight: every inverse depth is pulled to target[i] with this information.
        threshold: energy above which a residual is an outlier.

    Returns:
        T_frame_first, brightness, RMSE in grey levels, share of points in view.
    """
    T, light = T_frame_first.copy(), brightness.copy()
    system, trial_system = np.empty((COLUMNS, COLUMNS)), np.empty((COLUMNS, COLUMNS))
    energy, in_view = linearize_level(
        points, residuals, count, image, width, height, intrinsics, T, light, threshold, scratch, system
    )
    total = energy + regularization_energy(points, count, target, weight)
    pull = translation_information * count
    total += pull * (T[:3, 3] * T[:3, 3]).sum()
    damping = 0.1
    H, b = np.empty((PARAMETERS, PARAMETERS)), np.empty(PARAMETERS)
    for _ in range(max_iterations):
        if in_view < 20:
            return T, light, np.inf, 0.0
        # d r / d (ln gain, offset) is -gain I_host and -1; the pair's columns are I_host and 1
        scale = np.ones(PARAMETERS)
        scale[6], scale[7] = -math.exp(light[0]), -1.0
        for i in range(PARAMETERS):
            b[i] = system[FIRST + i, COLUMNS - 1]
            for j in range(i + 1):
                H[i, j] = system[FIRST + j, FIRST + i]
        for i in range(PARAMETERS):
            H[i, i] *= 1.0 + damping
        eliminate_idepths(points, residuals.idepth_relative[0], count, target, weight, damping, H, b)
        for i in range(PARAMETERS):
            b[i] *= scale[i]
            for j in range(i + 1):
                H[i, j] *= scale[i] * scale[j]
        for k in range(3):
            H[k, k] += pull
            b[k] += pull * T[k, 3]
        step = -solve_positive(H, b)
        old_idepth = points.idepth[:count].copy()
        old_hessian, old_gradient = points.idepth_hessian[:count].copy(), points.idepth_gradient[:count].copy()
        old_rows = residuals.idepth_relative[0, :, :count].copy()
        step_idepths(points, residuals.idepth_relative[0], count, target, weight, damping, step * scale)
        trial_T, trial_light = se3.exp(step[:6]) @ T, light + step[6:]
        trial_energy, trial_in_view = linearize_level(
            points, residuals, count, image, width, height, intrinsics, trial_T, trial_light, threshold, scratch,
            trial_system,
        )  # fmt: skip
        trial_total = trial_energy + regularization_energy(points, count, target, weight)
        trial_total += pull * (trial_T[:3, 3] * trial_T[:3, 3]).sum()
        small = step_size(step) * intrinsics[0] < MIN_STEP
        if trial_in_view >= 20 and trial_total / trial_in_view < total / in_view:
            T, light, energy, total, in_view = trial_T, trial_light, trial_energy, trial_total, trial_in_view
            system[:] = trial_system
            damping = max(0.5 * damping, 1e-4)
        else:
            points.idepth[:count] = old_idepth
            points.idepth_hessian[:count], points.idepth_gradient[:count] = old_hessian, old_gradient
            residuals.idepth_relative[0, :, :count] = old_rows
            damping = min(4.0 * damping, 1e4)
        if small:
            break
    return T, light, math.sqrt(energy / max(8 * in_view, 1)), in_view / count


@kernel
def smooth(idepth: np.ndarray, hessian: np.ndarray, neighbours: np.ndarray, own: float, result: np.ndarray) -> None:
    """Average every inverse depth with the median of its informative neighbours (weights own and 1 - own)."""
    values = np.empty(neighbours.shape[1], np.float32)
    for i in range(idepth.size):
        n = 0
        for k in range(neighbours.shape[1]):
            j = neighbours[i, k]
            if hessian[j] > 0:
                values[n] = idepth[j]
                n += 1
        result[i] = own * idepth[i] + (1.0 - own) * np.median(values[:n]) if n > 2 else idepth[i]
