# SPDX-License-Identifier: BSD-3-Clause
"""Where a small patch of one image is in another one, to a fraction of a pixel.

The brightness of the patch may differ by a gain and an offset. Both are eliminated in closed form, so that Gauss-Newton
has two unknowns. Images are flat float32 arrays.
"""

import math
from typing import Tuple

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel
from ceiling_dso_ros.dso.images.interpolation import sample_gradient

RADIUS = 4  # pixels: patches are 9 x 9
SIDE = 2 * RADIUS + 1
UNKNOWNS = 4  # shift, gain, offset
ITERATIONS = 12
DAMPING = 1e-2  # share of the trace: along an edge, where nothing tells the position, a patch does not run away
CONVERGED_PX = 3e-3
LARGEST_SHIFT_PX = 8.0
LEAST_VARIANCE = 0.1  # of a pixel's noise, grey levels squared: rounding alone makes 0.08
LEAST_EXPLAINED = 0.7  # of the patch's contrast


@kernel
def _take_patch(host: np.ndarray, width: int, u: int, v: int, grey: np.ndarray) -> float:
    """Grey values of the host's patch less their mean, into (SIDE * SIDE,); returns the sum of their squares."""
    mean = 0.0
    for row in range(SIDE):
        for column in range(SIDE):
            value = host[(v + row - RADIUS) * width + u + column - RADIUS]
            grey[row * SIDE + column] = value
            mean += value
    mean /= SIDE * SIDE
    contrast = 0.0
    for k in range(SIDE * SIDE):
        grey[k] -= mean
        contrast += grey[k] * grey[k]
    return contrast


@kernel
def _linearize(
    target: np.ndarray, width: int, u: float, v: float, warp: np.ndarray, grey: np.ndarray, contrast: float,
    sums: np.ndarray,
) -> Tuple[float, float, float, float, float, float, float]:  # fmt: skip
    """Equations of a shift at (u, v), with gain and offset eliminated.

    Returns:
        xx, xy, yy, bx, by of the normal equations, the squares that are left, and the explained share of the contrast.
    """
    sums[:] = 0.0
    for row in range(SIDE):
        for column in range(SIDE):
            ox, oy = float(column - RADIUS), float(row - RADIUS)
            value, gx, gy = sample_gradient(
                target,
                width,
                np.float32(u + warp[0, 0] * ox + warp[0, 1] * oy),
                np.float32(v + warp[1, 0] * ox + warp[1, 1] * oy),
            )
            h = grey[row * SIDE + column]
            sums[0] += gx
            sums[1] += gy
            sums[2] += value
            sums[3] += gx * gx
            sums[4] += gx * gy
            sums[5] += gy * gy
            sums[6] += gx * value
            sums[7] += gy * value
            sums[8] += gx * h
            sums[9] += gy * h
            sums[10] += value * h
            sums[11] += value * value
    n = float(SIDE * SIDE)
    xx = sums[3] - sums[0] * sums[0] / n - sums[8] * sums[8] / contrast
    xy = sums[4] - sums[0] * sums[1] / n - sums[8] * sums[9] / contrast
    yy = sums[5] - sums[1] * sums[1] / n - sums[9] * sums[9] / contrast
    bx = sums[6] - sums[0] * sums[2] / n - sums[8] * sums[10] / contrast
    by = sums[7] - sums[1] * sums[2] / n - sums[9] * sums[10] / contrast
    spread = sums[11] - sums[2] * sums[2] / n
    error = spread - sums[10] * sums[10] / contrast
    explained = 1.0 - error / spread if sums[10] > 0.0 and spread > 0.0 else 0.0
    return xx, xy, yy, bx, by, error, explained


@kernel
def align_patches(
    host: np.ndarray, target: np.ndarray, width: int, height: int, pixels: np.ndarray, warps: np.ndarray,
    guesses: np.ndarray,
) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Find patches of the host's image in the target's.

    Args:
        host, target: images of the same size.
        width, height: of both.
        pixels: (N, 2) int64 middles of the patches in the host, RADIUS and more from its border.
        warps: (N, 2, 2) float64, what one pixel of the host along x and y is in the target.
        guesses: (N, 2) float64 positions in the target; nan where a patch is not to be found.

    Returns:
        positions: (N, 2) float64; nan where the patch was not found.
        information: (N, 2, 2) float64 of the position, 1 / pixels squared, for the noise of one of the two images.
        own: (N, 2, 2) float64 the same of the patch's position in the host, in the host's pixels.
    """
    count = pixels.shape[0]
    positions = np.full((count, 2), np.nan)
    information, own = np.zeros((count, 2, 2)), np.zeros((count, 2, 2))
    grey = np.zeros(SIDE * SIDE)
    sums = np.zeros(12)
    for i in range(count):
        if not math.isfinite(guesses[i, 0]):
            continue
        contrast = _take_patch(host, width, pixels[i, 0], pixels[i, 1], grey)
        if contrast < SIDE * SIDE:
            continue
        a, b, c, d = warps[i, 0, 0], warps[i, 0, 1], warps[i, 1, 0], warps[i, 1, 1]
        reach_x, reach_y = RADIUS * (abs(a) + abs(b)) + 3.0, RADIUS * (abs(c) + abs(d)) + 3.0
        u, v = guesses[i, 0], guesses[i, 1]
        step = 1.0
        xx = xy = yy = error = explained = 0.0
        for _ in range(ITERATIONS):
            if not (reach_x < u < width - 1 - reach_x and reach_y < v < height - 1 - reach_y):
                step = 1.0
                break
            xx, xy, yy, bx, by, error, explained = _linearize(target, width, u, v, warps[i], grey, contrast, sums)
            more = DAMPING * (xx + yy) + 1e-9
            determinant = (xx + more) * (yy + more) - xy * xy
            du, dv = -((yy + more) * bx - xy * by) / determinant, -((xx + more) * by - xy * bx) / determinant
            u, v = u + du, v + dv
            step = math.hypot(du, dv)
            if step < CONVERGED_PX:
                break
        shift = math.hypot(u - guesses[i, 0], v - guesses[i, 1])
        if not (step < 10.0 * CONVERGED_PX and explained > LEAST_EXPLAINED and shift < LARGEST_SHIFT_PX):
            continue
        variance = max(0.5 * error / (SIDE * SIDE - UNKNOWNS), LEAST_VARIANCE)  # of each of the two images
        positions[i, 0], positions[i, 1] = u, v
        xx, xy, yy = xx / variance, xy / variance, yy / variance
        information[i, 0, 0], information[i, 0, 1], information[i, 1, 0], information[i, 1, 1] = xx, xy, xy, yy
        own[i, 0, 0] = a * (a * xx + c * xy) + c * (a * xy + c * yy)
        own[i, 0, 1] = a * (b * xx + d * xy) + c * (b * xy + d * yy)
        own[i, 1, 0] = own[i, 0, 1]
        own[i, 1, 1] = b * (b * xx + d * xy) + d * (b * xy + d * yy)
    return positions, information, own
