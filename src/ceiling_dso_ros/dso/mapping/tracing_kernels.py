# SPDX-License-Identifier: BSD-3-Clause
"""Kernels that trace candidate points along their epipolar line in a new frame."""

import math
from typing import Tuple

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel, kernel_inlined, kernel_noalias
from ceiling_dso_ros.dso.geometry.projection import Warp, idepth_at, warp_of, warp_offset, warp_point
from ceiling_dso_ros.dso.images.interpolation import sample, sample_gradient
from ceiling_dso_ros.dso.images.pattern import HUBER, PATTERN_SIZE, PATTERN_X, PATTERN_Y
from ceiling_dso_ros.dso.window import trace_outcome
from ceiling_dso_ros.dso.window.candidates import UNSEARCHED_QUALITY, CandidateArrays

BORDER = 5.0  # pixels between a search and the edge of the image
MAX_STEPS = 99
MIN_INTERVAL = 1.5  # pixels: shorter intervals are not searched
MAX_ERROR = 10.0  # pixels
REFINEMENTS = 3
MIN_REFINEMENT = 0.1  # pixels
OUTLIER_ENERGY = 12.0 * 12.0 * 8 * 1.2
SECOND_BEST_RADIUS = 2
MAX_QUALITY = np.float32(0.1 * UNSEARCHED_QUALITY)
DEPTH_RATIO = (0.75, 1.5)
SEARCH = -1  # not an outcome: the interval is long enough for a search
ZERO, ONE, TWO = np.float32(0), np.float32(1), np.float32(2)


@kernel_noalias
def line_energies(
    image: np.ndarray, width: int, x0: np.float32, y0: np.float32, step_x: np.float32, step_y: np.float32,
    expected: np.ndarray, pattern_x: np.ndarray, pattern_y: np.ndarray, energies: np.ndarray,
) -> None:  # fmt: skip
    """Huber energy of the pattern at (x0, y0) + s (step_x, step_y) for every s into energies[s]."""
    for s in range(energies.size):
        x, y = x0 + np.float32(s) * step_x, y0 + np.float32(s) * step_y
        energy = ZERO
        for p in range(PATTERN_SIZE):
            residual = sample(image, width, x + pattern_x[p], y + pattern_y[p]) - expected[p]
            weight = HUBER / max(abs(residual), HUBER)
            energy += weight * residual * residual * (TWO - weight)
        energies[s] = energy


@kernel
def best_step(energies: np.ndarray) -> Tuple[int, float]:
    """Index of the smallest energy, and the ratio of the best energy outside 2 steps around it to it."""
    best = 0
    for s in range(1, energies.size):
        if energies[s] < energies[best]:
            best = s
    second = np.float32(1e10)
    for s in range(energies.size):
        if abs(s - best) > SECOND_BEST_RADIUS and energies[s] < second:
            second = energies[s]
    return best, second / max(energies[best], np.float32(1e-3))


@kernel
def refine_along_line(
    image: np.ndarray, width: int, height: int, x: float, y: float, line_x: float, line_y: float,
    expected: np.ndarray, pattern_x: np.ndarray, pattern_y: np.ndarray,
) -> Tuple[float, float, float]:  # fmt: skip
    """Gauss-Newton for the position along the line; returns (x, y, energy) of the best one seen."""
    best_x, best_y, best_energy = x, y, np.float32(np.inf)
    direction_x, direction_y = np.float32(line_x), np.float32(line_y)
    step = 0.0
    for _ in range(REFINEMENTS + 1):
        H, b, energy = ONE, ZERO, ZERO
        centre_x, centre_y = np.float32(x), np.float32(y)
        for p in range(PATTERN_SIZE):
            value, grad_x, grad_y = sample_gradient(image, width, centre_x + pattern_x[p], centre_y + pattern_y[p])
            residual = value - expected[p]
            derivative = direction_x * grad_x + direction_y * grad_y
            weight = HUBER / max(abs(residual), HUBER)
            H += weight * derivative * derivative
            b += weight * residual * derivative
            energy += weight * residual * residual * (TWO - weight)
        if energy < best_energy:
            best_x, best_y, best_energy = x, y, energy
            step = min(max(-b / H, -0.5), 0.5)
        else:
            step *= -0.5  # overshoot: go half of the step back
        if abs(step) < MIN_REFINEMENT:
            break
        x = min(max(x + step * line_x, BORDER - 1.0), width - BORDER)
        y = min(max(y + step * line_y, BORDER - 1.0), height - BORDER)
    return best_x, best_y, best_energy


@kernel_inlined
def inside(x: float, y: float, width: int, height: int) -> bool:
    """Whether a search may end at (x, y)."""
    return (x > BORDER) & (y > BORDER) & (x < width - 1 - BORDER) & (y < height - 1 - BORDER)


@kernel_inlined
def epipolar_segment(
    warp: Warp, u: float, v: float, idepth_min: float, idepth_max: float, max_search: float
) -> Tuple[float, float, float, float, float, float]:
    """Where a pixel's interval of inverse depth projects.

    Returns:
        Start (x, y), its depth in units of that in the host, direction of growing idepth, and length in pixels.
    """
    x, y, z, _ = warp_point(warp, u, v, idepth_min)
    unbounded = math.isnan(idepth_max)
    far = idepth_min + 0.01 if unbounded else idepth_max
    x_far, y_far, _, _ = warp_point(warp, u, v, far)
    dx, dy = x_far - x, y_far - y
    length = math.sqrt(dx * dx + dy * dy)
    reach = max_search if unbounded else min(length, max_search)
    moves = length >= 1e-9
    return x, y, z, (dx / length if moves else 0.0), (dy / length if moves else 0.0), (reach if moves else 0.0)


@kernel_noalias
def plan_searches(
    u: np.ndarray, v: np.ndarray, idepth_min: np.ndarray, idepth_max: np.ndarray, grad_xx: np.ndarray,
    grad_xy: np.ndarray, grad_yy: np.ndarray, width: int, height: int, KRKi: np.ndarray, Kt: np.ndarray,
    max_search: float, x: np.ndarray, y: np.ndarray, line_x: np.ndarray, line_y: np.ndarray, length: np.ndarray,
    error: np.ndarray, outcome: np.ndarray,
) -> None:  # fmt: skip
    """Find where candidates of a host would be searched, and which of them need no search.

    Args:
        u, v, idepth_min, idepth_max, grad_xx, grad_xy, grad_yy: (n,) float32, as in `CandidateArrays`.
        width, height, KRKi, Kt, max_search: as in `trace_host`.
        x, y, line_x, line_y, length: (n,) float64 output, as `epipolar_segment` returns them.
        error: (n,) float64 output, expected error of a search given the image gradient, pixels.
        outcome: (n,) int64 output, SEARCH or the outcome of a candidate that is not searched.
    """
    warp = warp_of(KRKi, Kt)
    for i in range(u.size):
        low, high = np.float64(idepth_min[i]), np.float64(idepth_max[i])
        start_x, start_y, ratio, cx, cy, reach = epipolar_segment(warp, u[i], v[i], low, high, max_search)
        in_view = (ratio > DEPTH_RATIO[0]) & (ratio < DEPTH_RATIO[1]) & inside(start_x, start_y, width, height)
        in_view &= inside(start_x + reach * cx, start_y + reach * cy, width, height)
        bounded = not math.isnan(high)
        short = ((reach < MIN_INTERVAL) & bounded) | (reach == 0.0)
        along = cx * cx * grad_xx[i] + 2.0 * cx * cy * grad_xy[i] + cy * cy * grad_yy[i]
        across = cy * cy * grad_xx[i] - 2.0 * cx * cy * grad_xy[i] + cx * cx * grad_yy[i]
        uncertainty = 0.2 + 0.2 * (along + across) / max(along, 1e-6)
        searched = SEARCH if not (bounded & (2.0 * uncertainty > reach)) else trace_outcome.BAD_CONDITION
        outcome[i] = (trace_outcome.SKIPPED if short else searched) if in_view else trace_outcome.OUT_OF_BOUNDS
        x[i], y[i], line_x[i], line_y[i], length[i] = start_x, start_y, cx, cy, reach
        error[i] = min(uncertainty, MAX_ERROR)


@kernel
def search(
    candidates: CandidateArrays, i: int, image: np.ndarray, width: int, height: int,
    KRKi: np.ndarray, Kt: np.ndarray, gain: float, offset: float,
    x: float, y: float, line_x: float, line_y: float, length: float, error: float,
    expected: np.ndarray, pattern_x: np.ndarray, pattern_y: np.ndarray, energies: np.ndarray,
) -> int:  # fmt: skip
    """Narrow the interval of candidate i by a search; returns its outcome. The last four are scratch memory."""
    warp, u, v = warp_of(KRKi, Kt), candidates.u[i], candidates.v[i]
    for p in range(PATTERN_SIZE):
        expected[p] = gain * candidates.grey[p, i] + offset
        pattern_x[p], pattern_y[p] = warp_offset(warp, PATTERN_X[p], PATTERN_Y[p])
    steps = min(int(length) + 2, MAX_STEPS)
    stride = length / (steps - 1)
    line_energies(
        image, width, np.float32(x), np.float32(y), np.float32(stride * line_x), np.float32(stride * line_y),
        expected, pattern_x, pattern_y, energies[:steps],
    )  # fmt: skip
    best, quality = best_step(energies[:steps])
    quality = min(quality, MAX_QUALITY)
    if quality < candidates.quality[i] or steps > 10:
        candidates.quality[i] = quality
    x, y, energy = refine_along_line(
        image, width, height, x + best * stride * line_x, y + best * stride * line_y, line_x, line_y,
        expected, pattern_x, pattern_y,
    )  # fmt: skip
    failed = trace_outcome.DELETED if candidates.outcome[i] == trace_outcome.OUTLIER else trace_outcome.OUTLIER
    if energy > OUTLIER_ENERGY:
        candidates.interval[i] = 0.0
        return failed

    along_x = line_x * line_x > line_y * line_y  # the better conditioned coordinate
    a = idepth_at(warp, u, v, x - error * line_x, y - error * line_y, along_x)
    b = idepth_at(warp, u, v, x + error * line_x, y + error * line_y, along_x)
    idepth_min, idepth_max = max(min(a, b), 0.0), max(a, b)
    if not (math.isfinite(idepth_min) and math.isfinite(idepth_max) and idepth_max > 0.0):
        return failed
    candidates.interval[i] = 2.0 * error
    candidates.idepth_min[i], candidates.idepth_max[i] = idepth_min, idepth_max
    return trace_outcome.GOOD


@kernel
def trace_host(
    candidates: CandidateArrays, first: int, last: int, image: np.ndarray, width: int, height: int,
    KRKi: np.ndarray, Kt: np.ndarray, gain: float, offset: float, max_search: float,
) -> None:  # fmt: skip
    """Trace candidates[first:last], all of one host keyframe, in the image of another frame.

    Args:
        candidates: updated in place.
        first, last: range of the host.
        image, width, height: level 0 of the new frame, flat float32.
        KRKi, Kt: (3, 3) and (3,) float64, projection from host pixels at idepth 0, and its change with idepth.
        gain, offset: brightness transfer from host to frame, I_frame = gain I_host + offset.
        max_search: longest search in pixels.
    """
    expected, pattern_x = np.empty(PATTERN_SIZE, np.float32), np.empty(PATTERN_SIZE, np.float32)
    pattern_y, energies = np.empty(PATTERN_SIZE, np.float32), np.empty(MAX_STEPS, np.float32)
    plan, outcome = np.empty((6, last - first)), np.empty(last - first, np.int64)
    x, y, line_x, line_y, length, error = plan[0], plan[1], plan[2], plan[3], plan[4], plan[5]
    plan_searches(
        candidates.u[first:last], candidates.v[first:last], candidates.idepth_min[first:last],
        candidates.idepth_max[first:last], candidates.grad_xx[first:last], candidates.grad_xy[first:last],
        candidates.grad_yy[first:last], width, height, KRKi, Kt, max_search, x, y, line_x, line_y, length, error,
        outcome,
    )  # fmt: skip
    for k in range(last - first):
        i = first + k
        if candidates.outcome[i] == trace_outcome.DELETED:
            continue
        if outcome[k] != trace_outcome.OUT_OF_BOUNDS:
            candidates.interval[i] = length[k]
        if outcome[k] == SEARCH:
            candidates.outcome[i] = search(
                candidates, i, image, width, height, KRKi, Kt, gain, offset, x[k], y[k], line_x[k], line_y[k],
                length[k], error[k], expected, pattern_x, pattern_y, energies,
            )  # fmt: skip
        else:
            candidates.outcome[i] = outcome[k]
