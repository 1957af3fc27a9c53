"""Kernels that turn candidates into active points: spread them over the newest keyframe, refine their depth."""

import math
from typing import Tuple

import numpy as np

from ceiling_dso_ros.dso.candidates import CandidateArrays
from ceiling_dso_ros.dso.interpolation import sample_gradient
from ceiling_dso_ros.dso.jit import kernel
from ceiling_dso_ros.dso.pair_geometry import PairGeometry
from ceiling_dso_ros.dso.pattern import GRADIENT_WEIGHT, HUBER, PATTERN_SIZE, PATTERN_X, PATTERN_Y
from ceiling_dso_ros.dso.window import KeyframeArrays

OUTLIER_ENERGY = np.float32(12.0 * 12.0 * 8)
ZERO, ONE, TWO, HALF = np.float32(0), np.float32(1), np.float32(2), np.float32(0.5)


@kernel
def stamp_distance(distance2: np.ndarray, x: int, y: int, reach: int) -> None:
    """Lower the squared distances of a map, (height, width) int32, around a new point."""
    height, width = distance2.shape
    for row in range(max(0, y - reach), min(height, y + reach + 1)):
        dy2 = (row - y) * (row - y)
        for column in range(max(0, x - reach), min(width, x + reach + 1)):
            d2 = dy2 + (column - x) * (column - x)
            if d2 < distance2[row, column]:
                distance2[row, column] = d2


@kernel
def spread(
    x: np.ndarray, y: np.ndarray, min_distance: np.ndarray, distance2: np.ndarray, reach: int, accepted: np.ndarray
) -> None:
    """Accept, in order, points at least min_distance from all others of the map; each accepted one joins the map."""
    height, width = distance2.shape
    for i in range(x.size):
        column, row = int(x[i] + HALF), int(y[i] + HALF)
        if 0 <= column < width and 0 <= row < height and distance2[row, column] >= min_distance[i] * min_distance[i]:
            accepted[i] = True
            stamp_distance(distance2, column, row, reach)


@kernel
def project(
    u: np.ndarray, v: np.ndarray, idepth: np.ndarray, host: np.ndarray, pairs: PairGeometry, target: int,
    x: np.ndarray, y: np.ndarray, new_idepth: np.ndarray,
) -> None:  # fmt: skip
    """Pixel and inverse depth of points in a target keyframe; float32. Points hosted there stay where they are."""
    for i in range(u.size):
        if host[i] == target:
            x[i], y[i], new_idepth[i] = u[i], v[i], idepth[i]
            continue
        KRKi, Kt = pairs.KRKi[host[i], target], pairs.Kt[host[i], target]
        z = KRKi[2, 0] * u[i] + KRKi[2, 1] * v[i] + KRKi[2, 2] + Kt[2] * idepth[i]
        x[i] = (KRKi[0, 0] * u[i] + KRKi[0, 1] * v[i] + KRKi[0, 2] + Kt[0] * idepth[i]) / z
        y[i] = (KRKi[1, 0] * u[i] + KRKi[1, 1] * v[i] + KRKi[1, 2] + Kt[1] * idepth[i]) / z
        new_idepth[i] = idepth[i] / z


@kernel
def residual_in_target(
    candidates: CandidateArrays, i: int, idepth: np.float32, image: np.ndarray, width: int, height: int,
    KRKi: np.ndarray, Kt: np.ndarray, gain: np.float32, offset: np.float32,
) -> Tuple[np.float32, np.float32, np.float32]:  # fmt: skip
    """Energy, H and b of the inverse depth of a candidate in one target; the energy is inf outside the image."""
    energy = hessian = gradient = ZERO
    right, bottom = np.float32(width - 3), np.float32(height - 3)
    for p in range(PATTERN_SIZE):
        pu, pv = candidates.u[i] + PATTERN_X[p], candidates.v[i] + PATTERN_Y[p]
        z = KRKi[2, 0] * pu + KRKi[2, 1] * pv + KRKi[2, 2] + Kt[2] * idepth
        x = (KRKi[0, 0] * pu + KRKi[0, 1] * pv + KRKi[0, 2] + Kt[0] * idepth) / z
        y = (KRKi[1, 0] * pu + KRKi[1, 1] * pv + KRKi[1, 2] + Kt[1] * idepth) / z
        if not (x > TWO and y > TWO and x < right and y < bottom and z > ZERO):
            return np.float32(np.inf), ZERO, ZERO
        value, grad_x, grad_y = sample_gradient(image, width, x, y)
        residual = value - gain * candidates.grey[p, i] - offset
        gradient2 = grad_x * grad_x + grad_y * grad_y
        weight = HALF * (candidates.weight[p, i] + np.sqrt(GRADIENT_WEIGHT / (GRADIENT_WEIGHT + gradient2)))
        huber = HUBER / max(abs(residual), HUBER)
        derivative = (grad_x * (Kt[0] - x * Kt[2]) + grad_y * (Kt[1] - y * Kt[2])) / z
        w = weight * weight * huber
        energy += w * residual * residual * (TWO - huber)
        hessian += w * derivative * derivative
        gradient += w * derivative * residual
    return energy, hessian, gradient


@kernel
def total_energy(
    candidates: CandidateArrays, i: int, idepth: np.float32, n: int, images: np.ndarray, width: int, height: int,
    keyframes: KeyframeArrays, pairs: PairGeometry, inlier: np.ndarray,
) -> Tuple[np.float32, np.float32, np.float32]:  # fmt: skip
    """Energy, H and b of a candidate's inverse depth over the window; outliers count with the threshold."""
    energy = hessian = gradient = ZERO
    host = candidates.host[i]
    for target in range(n):
        inlier[target] = 0
        if target == host:
            continue
        e, h, g = residual_in_target(
            candidates, i, idepth, images[keyframes.image_slot[target]], width, height,
            pairs.KRKi[host, target], pairs.Kt[host, target], pairs.gain[host, target], pairs.offset[host, target],
        )  # fmt: skip
        if e > OUTLIER_ENERGY:
            energy += OUTLIER_ENERGY
            continue
        inlier[target] = 1
        energy += e
        hessian += h
        gradient += g
    return energy, hessian, gradient


@kernel
def refine_idepths(
    candidates: CandidateArrays, chosen: np.ndarray, n: int, images: np.ndarray, width: int, height: int,
    keyframes: KeyframeArrays, pairs: PairGeometry, iterations: int, min_hessian: float,
    idepths: np.ndarray, inliers: np.ndarray,
) -> None:  # fmt: skip
    """Levenberg-Marquardt for the inverse depth of chosen candidates over all keyframes of the window.

    Args:
        chosen: (m,) int64 indices of candidates.
        idepths: (m,) float32 output, nan where the candidate is not fit to become a point, inf where it may be later.
        inliers: (n slots, m) uint8 output, 1 for targets in which it is an inlier.
    """
    flags = np.zeros(inliers.shape[0], np.uint8)
    trial_flags = np.zeros(inliers.shape[0], np.uint8)
    for k in range(chosen.size):
        i = chosen[k]
        idepth = HALF * (candidates.idepth_min[i] + candidates.idepth_max[i])
        energy, hessian, gradient = total_energy(
            candidates, i, idepth, n, images, width, height, keyframes, pairs, flags
        )
        damping = np.float32(0.1)
        for _ in range(iterations):
            if hessian < min_hessian:
                break
            step = -gradient / (hessian * (ONE + damping))
            trial = idepth + step
            e, h, g = total_energy(candidates, i, trial, n, images, width, height, keyframes, pairs, trial_flags)
            if e < energy:
                idepth, energy, hessian, gradient = trial, e, h, g
                flags[:] = trial_flags
                damping *= HALF
            else:
                damping *= np.float32(5)
            if abs(step) < np.float32(1e-4) * idepth:
                break
        seen = flags.sum() > 0 and idepth > ZERO and math.isfinite(idepth)
        idepths[k] = (idepth if hessian >= min_hessian else np.inf) if seen else np.nan
        inliers[:, k] = flags
