"""Kernels that trace candidate points along their epipolar line in a new frame."""

import math
from typing import Tuple

import numpy as np

from ceiling_dso_ros.dso import candidates as status
from ceiling_dso_ros.dso.candidates import CandidateArrays
from ceiling_dso_ros.dso.interpolation import sample, sample_gradient
from ceiling_dso_ros.dso.jit import kernel, kernel_noalias
from ceiling_dso_ros.dso.pattern import HUBER, PATTERN_SIZE, PATTERN_X, PATTERN_Y

BORDER = 5.0  # pixels that the search keeps off the image's edge
MAX_STEPS = 99
MIN_INTERVAL = 1.5  # pixels: shorter intervals are not searched
MAX_ERROR = 10.0  # pixels
REFINEMENTS = 3
MIN_REFINEMENT = 0.1  # pixels
OUTLIER_ENERGY = 12.0 * 12.0 * 8 * 1.2
SECOND_BEST_RADIUS = 2
MAX_QUALITY = np.float32(0.1 * status.UNSEARCHED_QUALITY)
DEPTH_RATIO = (0.75, 1.5)
ZERO, ONE, TWO = np.float32(0), np.float32(1), np.float32(2)

Point = Tuple[float, float, float]


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
            step *= -0.5  # went too far: half way back
        if abs(step) < MIN_REFINEMENT:
            break
        x = min(max(x + step * line_x, BORDER - 1.0), width - BORDER)
        y = min(max(y + step * line_y, BORDER - 1.0), height - BORDER)
    return best_x, best_y, best_energy


@kernel
def inside(x: float, y: float, width: int, height: int) -> bool:
    """Whether a search may end at (x, y)."""
    return x > BORDER and y > BORDER and x < width - 1 - BORDER and y < height - 1 - BORDER


@kernel
def epipolar_segment(
    projected: Point, Kt: np.ndarray, idepth_min: float, idepth_max: float, max_search: float
) -> Tuple[float, float, float, float, float]:
    """Where the interval of inverse depth projects: start (x, y), direction of growing idepth, and length in pixels."""
    z = projected[2] + Kt[2] * idepth_min
    x = (projected[0] + Kt[0] * idepth_min) / z
    y = (projected[1] + Kt[1] * idepth_min) / z
    unbounded = math.isnan(idepth_max)
    far = idepth_min + 0.01 if unbounded else idepth_max
    z_far = projected[2] + Kt[2] * far
    dx = (projected[0] + Kt[0] * far) / z_far - x
    dy = (projected[1] + Kt[1] * far) / z_far - y
    length = math.sqrt(dx * dx + dy * dy)
    if length < 1e-9:
        return x, y, 0.0, 0.0, 0.0
    reach = max_search if unbounded else min(length, max_search)
    return x, y, dx / length, dy / length, reach


@kernel
def idepth_at(projected: Point, Kt: np.ndarray, x: float, y: float, line_x: float, line_y: float) -> float:
    """Inverse depth in the host of the point that projects to (x, y); uses the better conditioned coordinate."""
    if line_x * line_x > line_y * line_y:
        return (projected[2] * x - projected[0]) / (Kt[0] - Kt[2] * x)
    return (projected[2] * y - projected[1]) / (Kt[1] - Kt[2] * y)


@kernel
def trace_one(
    candidates: CandidateArrays, i: int, image: np.ndarray, width: int, height: int,
    KRKi: np.ndarray, Kt: np.ndarray, gain: float, offset: float, max_search: float,
    expected: np.ndarray, pattern_x: np.ndarray, pattern_y: np.ndarray, energies: np.ndarray,
) -> int:  # fmt: skip
    """Narrow the interval of candidate i; returns its new status. The last four arguments are scratch memory."""
    u, v = candidates.u[i], candidates.v[i]
    projected = (
        KRKi[0, 0] * u + KRKi[0, 1] * v + KRKi[0, 2],
        KRKi[1, 0] * u + KRKi[1, 1] * v + KRKi[1, 2],
        KRKi[2, 0] * u + KRKi[2, 1] * v + KRKi[2, 2],
    )
    idepth_min, idepth_max = np.float64(candidates.idepth_min[i]), np.float64(candidates.idepth_max[i])
    bounded = not math.isnan(idepth_max)
    ratio = projected[2] + Kt[2] * idepth_min
    if not (DEPTH_RATIO[0] < ratio < DEPTH_RATIO[1]):
        return status.OUT_OF_BOUNDS
    x, y, line_x, line_y, length = epipolar_segment(projected, Kt, idepth_min, idepth_max, max_search)
    if not inside(x, y, width, height) or not inside(x + length * line_x, y + length * line_y, width, height):
        return status.OUT_OF_BOUNDS
    candidates.interval[i] = length
    if length < MIN_INTERVAL and bounded:
        return status.SKIPPED
    if line_x == 0.0 and line_y == 0.0:
        return status.SKIPPED

    along = line_x * line_x * candidates.grad_xx[i] + 2.0 * line_x * line_y * candidates.grad_xy[i]
    along += line_y * line_y * candidates.grad_yy[i]
    across = line_y * line_y * candidates.grad_xx[i] - 2.0 * line_x * line_y * candidates.grad_xy[i]
    across += line_x * line_x * candidates.grad_yy[i]
    error = 0.2 + 0.2 * (along + across) / max(along, 1e-6)
    if bounded and 2.0 * error > length:
        return status.BAD_CONDITION
    error = min(error, MAX_ERROR)

    for p in range(PATTERN_SIZE):
        expected[p] = gain * candidates.grey[p, i] + offset
        pattern_x[p] = KRKi[0, 0] * PATTERN_X[p] + KRKi[0, 1] * PATTERN_Y[p]
        pattern_y[p] = KRKi[1, 0] * PATTERN_X[p] + KRKi[1, 1] * PATTERN_Y[p]
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
    if energy > OUTLIER_ENERGY:
        candidates.interval[i] = 0.0
        return status.DELETED if candidates.status[i] == status.OUTLIER else status.OUTLIER

    a = idepth_at(projected, Kt, x - error * line_x, y - error * line_y, line_x, line_y)
    b = idepth_at(projected, Kt, x + error * line_x, y + error * line_y, line_x, line_y)
    idepth_min, idepth_max = max(min(a, b), 0.0), max(a, b)
    if not (math.isfinite(idepth_min) and math.isfinite(idepth_max) and idepth_max > 0.0):
        return status.DELETED if candidates.status[i] == status.OUTLIER else status.OUTLIER
    candidates.interval[i] = 2.0 * error
    candidates.idepth_min[i], candidates.idepth_max[i] = idepth_min, idepth_max
    return status.GOOD


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
    for i in range(first, last):
        if candidates.status[i] != status.DELETED:
            candidates.status[i] = trace_one(
                candidates, i, image, width, height, KRKi, Kt, gain, offset, max_search,
                expected, pattern_x, pattern_y, energies,
            )  # fmt: skip
