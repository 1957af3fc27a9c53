# SPDX-License-Identifier: BSD-3-Clause
"""Kernels that turn candidates into active points: spread them over the newest keyframe, refine their depth."""

import math
from typing import NamedTuple

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel, kernel_noalias
from ceiling_dso_ros.dso.geometry.projection import epipolar_direction, in_view, warp_of, warp_point
from ceiling_dso_ros.dso.images.interpolation import sample_gradient
from ceiling_dso_ros.dso.images.pattern import GRADIENT_WEIGHT, HUBER, PATTERN_SIZE, PATTERN_X, PATTERN_Y
from ceiling_dso_ros.dso.window.keyframe_window import KeyframeArrays
from ceiling_dso_ros.dso.window.pair_geometry import PairGeometry

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


class DepthSums(NamedTuple):
    """Per candidate, float32: energy, Hessian and gradient of its inverse depth; in_bounds 1 while all is in view."""

    energy: np.ndarray
    hessian: np.ndarray
    gradient: np.ndarray
    in_bounds: np.ndarray


@kernel
def new_sums(m: int) -> DepthSums:
    """Zeroed sums of m candidates."""
    return DepthSums(np.zeros(m, np.float32), np.zeros(m, np.float32), np.zeros(m, np.float32), np.zeros(m, np.float32))


@kernel_noalias
def add_pixel(
    image: np.ndarray, width: int, height: int, KRKi: np.ndarray, Kt: np.ndarray, gain: np.float32, offset: np.float32,
    pattern_x: np.float32, pattern_y: np.float32,
    u: np.ndarray, v: np.ndarray, idepth: np.ndarray, grey: np.ndarray, weight_host: np.ndarray, sums: DepthSums,
) -> None:  # fmt: skip
    """Add one pixel of the pattern of every candidate of a host, seen in one target, to the sums."""
    warp = warp_of(KRKi, Kt)
    for i in range(u.size):
        x, y, z, z_inverse = warp_point(warp, u[i] + pattern_x, v[i] + pattern_y, idepth[i])
        inside = in_view(x, y, z, width, height)
        x, y = (x if inside else TWO), (y if inside else TWO)
        value, grad_x, grad_y = sample_gradient(image, width, x, y)
        residual = value - gain * grey[i] - offset
        gradient2 = grad_x * grad_x + grad_y * grad_y
        weight = HALF * (weight_host[i] + np.sqrt(GRADIENT_WEIGHT / (GRADIENT_WEIGHT + gradient2)))
        huber = HUBER / max(abs(residual), HUBER)
        direction_x, direction_y = epipolar_direction(warp, x, y)
        derivative = (grad_x * direction_x + grad_y * direction_y) * z_inverse
        w = weight * weight * huber
        sums.energy[i] += w * residual * residual * (TWO - huber)
        sums.hessian[i] += w * derivative * derivative
        sums.gradient[i] += w * derivative * residual
        sums.in_bounds[i] = sums.in_bounds[i] if inside else ZERO


@kernel
def add_target(pair: DepthSums, total: DepthSums, inlier: np.ndarray) -> None:
    """Add a target's sums to the total; where a candidate is an outlier or out of view, the threshold alone."""
    for i in range(inlier.size):
        good = pair.in_bounds[i] > ZERO and pair.energy[i] <= OUTLIER_ENERGY
        inlier[i] = 1 if good else 0
        total.energy[i] += pair.energy[i] if good else OUTLIER_ENERGY
        total.hessian[i] += pair.hessian[i] if good else ZERO
        total.gradient[i] += pair.gradient[i] if good else ZERO


@kernel
def depth_energies(
    u: np.ndarray, v: np.ndarray, grey: np.ndarray, weight: np.ndarray, idepth: np.ndarray, ranges: np.ndarray,
    images: np.ndarray, width: int, height: int, keyframes: KeyframeArrays, pairs: PairGeometry,
    pair: DepthSums, total: DepthSums, inlier: np.ndarray,
) -> None:  # fmt: skip
    """Sums over the window for candidates at given inverse depths.

    Args:
        u, v, idepth: (m,) float32, sorted by host; grey, weight: (8, m).
        ranges: (n + 1,) first candidate of each host slot, and the end.
        pair: scratch memory; total: output.
        inlier: (n, m) uint8 output, 1 for targets in which a candidate is an inlier.
    """
    for array in total:
        array[:] = ZERO
    inlier[:] = 0
    n = ranges.size - 1
    for host in range(n):
        first, last = ranges[host], ranges[host + 1]
        part = DepthSums(pair.energy[first:last], pair.hessian[first:last], pair.gradient[first:last],
                         pair.in_bounds[first:last])  # fmt: skip
        whole = DepthSums(total.energy[first:last], total.hessian[first:last], total.gradient[first:last],
                          total.in_bounds[first:last])  # fmt: skip
        for target in range(n):
            if target == host:
                continue
            part.energy[:], part.hessian[:], part.gradient[:], part.in_bounds[:] = ZERO, ZERO, ZERO, ONE
            for p in range(PATTERN_SIZE):
                add_pixel(
                    images[keyframes.image_slot[target]], width, height, pairs.KRKi[host, target],
                    pairs.Kt[host, target], pairs.gain[host, target], pairs.offset[host, target],
                    PATTERN_X[p], PATTERN_Y[p], u[first:last], v[first:last], idepth[first:last],
                    grey[p, first:last], weight[p, first:last], part,
                )  # fmt: skip
            add_target(part, whole, inlier[target, first:last])


@kernel
def refine_idepths(
    u: np.ndarray, v: np.ndarray, grey: np.ndarray, weight: np.ndarray, idepth: np.ndarray, ranges: np.ndarray,
    images: np.ndarray, width: int, height: int, keyframes: KeyframeArrays, pairs: PairGeometry,
    iterations: int, min_hessian: float,
) -> np.ndarray:  # fmt: skip
    """Levenberg-Marquardt for the inverse depths of candidates over all keyframes of the window.

    Args:
        u, v, grey, weight, ranges: as in `depth_energies`.
        idepth: (m,) float32 first guess, and output: nan where a candidate cannot become a point, inf where it
            may become one later.

    Returns:
        (n, m) uint8, 1 for targets in which a candidate is an inlier.
    """
    m, n = u.size, ranges.size - 1
    pair, best, trial = new_sums(m), new_sums(m), new_sums(m)
    inlier, trial_inlier = np.zeros((n, m), np.uint8), np.zeros((n, m), np.uint8)
    depth_energies(u, v, grey, weight, idepth, ranges, images, width, height, keyframes, pairs, pair, best, inlier)
    damping = np.full(m, np.float32(0.1))
    moved = idepth.copy()
    for _ in range(iterations):
        for i in range(m):
            step = best.gradient[i] / (best.hessian[i] * (ONE + damping[i]))
            moved[i] = idepth[i] - step if best.hessian[i] >= min_hessian else idepth[i]
        depth_energies(
            u, v, grey, weight, moved, ranges, images, width, height, keyframes, pairs, pair, trial, trial_inlier
        )
        for i in range(m):
            if trial.energy[i] < best.energy[i]:
                idepth[i], best.energy[i] = moved[i], trial.energy[i]
                best.hessian[i], best.gradient[i] = trial.hessian[i], trial.gradient[i]
                inlier[:, i] = trial_inlier[:, i]
                damping[i] *= HALF
            else:
                damping[i] *= np.float32(5)
    for i in range(m):
        seen = inlier[:, i].sum() > 0 and idepth[i] > ZERO and math.isfinite(idepth[i])
        if not seen:
            idepth[i] = np.nan
        elif best.hessian[i] < min_hessian:
            idepth[i] = np.inf
    return inlier
