# SPDX-License-Identifier: BSD-3-Clause
"""Kernels that find points of the left image in the right one, along their epipolar lines.

A patch of the left image, with grey values L, is found where the right image has R = a L + b, with a gain and an offset
of its own: the two cameras may differ in exposure and vignette. Let g be the derivative of L along the epipolar line,
without what looks like a change of gain or offset: made orthogonal to L and to a constant. Then a shift d along the
line solves, whatever a and b are,

    sum g R(d) = 0.

Noise of L does not move this root: a central difference knows nothing of the noise of its own pixel. The smallest sum
of squared differences would be another one, see `noise`. What interpolation does to L and R depends on the fraction of
a pixel and cancels in the mean over points at any fractions of the left image, which points of other keyframes are.
"""

import math
from typing import Tuple

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel, kernel_inlined
from ceiling_dso_ros.dso.geometry.projection import (
    Warp,
    epipolar_direction,
    idepth_at,
    warp_of,
    warp_offset,
    warp_point,
)
from ceiling_dso_ros.dso.images.interpolation import sample, sample_gradient

RADIUS = 3  # pixels: of a patch, square
SIDE = 2 * RADIUS + 1
PATCH_SIZE = SIDE * SIDE
BORDER = RADIUS + 3.0  # pixels between a patch's centre and the edge: patches may be turned a little, samples are cubic
ITERATIONS = 10
CONVERGED = 0.005  # pixels
LARGEST_STEP = 0.5
FURTHEST = 2.0  # pixels from where the search begins: half a period of the finest texture that is found
LEAST_CORRELATION = 0.8  # of the two patches: more than half of the variance is common
LEAST_CONTRAST = 2.0  # grey levels, standard deviation of a patch
FLAT = 1e-3  # of a patch's squared gradient: less than that share is left without gain and offset


@kernel_inlined
def _inside(x: float, y: float, width: int, height: int) -> bool:
    return (x > BORDER) & (y > BORDER) & (x < width - 1 - BORDER) & (y < height - 1 - BORDER)


@kernel
def correlations(
    left: np.ndarray, left_width: int, right: np.ndarray, right_width: int, right_height: int,
    M: np.ndarray, t: np.ndarray, u: np.ndarray, v: np.ndarray, idepth: np.ndarray, scales: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """How well patches fit where assumed scales place them.

    Args:
        left, right: flat float32 images.
        left_width, right_width, right_height: of them.
        M, t: (3, 3) and (3,) float64 of the warp from left pixels to right ones; inverse depths in 1/m.
        u, v: (n,) float32 left pixels, all inside the image by BORDER.
        idepth: (n,) float32 inverse depths, 1/unit.
        scales: (m,) float64 metres per unit.

    Returns:
        (m, n) float32: correlation of the left and the right patch; nan where the right one is not in the image.
    """
    warp = warp_of(M, t)
    result = np.full((scales.size, u.size), np.nan, np.float32)
    patch = np.empty(PATCH_SIZE, np.float32)
    for i in range(u.size):
        mean, squares = _take(left, left_width, u[i], v[i], patch)
        if squares <= 0.0:
            continue
        for m in range(scales.size):
            x, y, z, _ = warp_point(warp, float(u[i]), float(v[i]), float(idepth[i]) / scales[m])
            if z <= 0.0 or not _inside(x, y, right_width, right_height):
                continue
            total = total_squares = product = 0.0
            for p in range(PATCH_SIZE):
                dx, dy = warp_offset(warp, float(p % SIDE - RADIUS), float(p // SIDE - RADIUS))
                value = float(sample(right, right_width, np.float32(x + dx), np.float32(y + dy)))
                total += value
                total_squares += value * value
                product += value * patch[p]
            variance = total_squares - total * total / PATCH_SIZE
            covariance = product - total * mean
            result[m, i] = covariance / math.sqrt(squares * variance) if variance > 1e-3 else 0.0
    return result


@kernel_inlined
def _take(image: np.ndarray, width: int, u: float, v: float, patch: np.ndarray) -> Tuple[float, float]:
    """Copy the patch around (u, v); returns the mean of its values, and the sum of their squared deviations from it."""
    total = squares = 0.0
    for p in range(PATCH_SIZE):
        x, y = np.float32(u + (p % SIDE - RADIUS)), np.float32(v + (p // SIDE - RADIUS))
        value, _, _ = sample_gradient(image, width, x, y)
        patch[p] = value
        total += float(value)
    mean = total / PATCH_SIZE
    for p in range(PATCH_SIZE):
        squares += (patch[p] - mean) ** 2
    return mean, squares


@kernel_inlined
def _derivative(
    image: np.ndarray, width: int, u: float, v: float, along_u: float, along_v: float, patch: np.ndarray, mean: float,
    squares: float, derivative: np.ndarray,
) -> Tuple[float, float]:  # fmt: skip
    """Derivative of a patch along a direction, without gain and offset; the sums of its squares, after and before."""
    total = product = before = 0.0
    for p in range(PATCH_SIZE):
        x, y = np.float32(u + (p % SIDE - RADIUS)), np.float32(v + (p // SIDE - RADIUS))
        _, grad_x, grad_y = sample_gradient(image, width, x, y)
        derivative[p] = along_u * grad_x + along_v * grad_y
        total += derivative[p]
        product += derivative[p] * (patch[p] - mean)
        before += derivative[p] * derivative[p]
    after = 0.0
    for p in range(PATCH_SIZE):
        derivative[p] -= total / PATCH_SIZE + product / squares * (patch[p] - mean)
        after += derivative[p] * derivative[p]
    return after, before


@kernel_inlined
def _left_direction(warp: Warp, along_x: float, along_y: float) -> Tuple[float, float]:
    """The direction in the left image that looks like a direction in the right one."""
    determinant = warp.xx * warp.yy - warp.xy * warp.yx
    return (warp.yy * along_x - warp.xy * along_y) / determinant, (warp.xx * along_y - warp.yx * along_x) / determinant


@kernel_inlined
def _compare(
    image: np.ndarray, width: int, x: float, y: float, warp: Warp, patch: np.ndarray, mean: float, squares: float,
    derivative: np.ndarray,
) -> Tuple[float, float, float]:  # fmt: skip
    """Gain of a place in the right image, its variance (a sum), and the sum whose root is wanted."""
    total = product = pull = total_squares = 0.0
    for p in range(PATCH_SIZE):
        dx, dy = warp_offset(warp, float(p % SIDE - RADIUS), float(p // SIDE - RADIUS))
        sampled, _, _ = sample_gradient(image, width, np.float32(x + dx), np.float32(y + dy))
        value = float(sampled)
        total += value
        total_squares += value * value
        product += value * (patch[p] - mean)
        pull += value * derivative[p]
    return product / squares, total_squares - total * total / PATCH_SIZE, pull


@kernel_inlined
def _shift(
    right: np.ndarray, right_width: int, right_height: int, warp: Warp, x: float, y: float, line_x: float,
    line_y: float, patch: np.ndarray, mean: float, squares: float, derivative: np.ndarray, information: float,
) -> Tuple[float, float]:  # fmt: skip
    """How far along the line from (x, y) a patch is found, and the standard deviation of that; nan if it is not."""
    shift = 0.0
    for _ in range(ITERATIONS):
        end_x, end_y = x + shift * line_x, y + shift * line_y
        if abs(shift) > FURTHEST or not _inside(end_x, end_y, right_width, right_height):
            return math.nan, math.nan
        gain, variance, pull = _compare(right, right_width, end_x, end_y, warp, patch, mean, squares, derivative)
        if gain <= 0.0 or variance <= 0.0:
            return math.nan, math.nan
        step = min(max(-pull / (gain * information), -LARGEST_STEP), LARGEST_STEP)
        shift += step
        if abs(step) < CONVERGED:
            explained = gain * gain * squares / variance
            if explained < LEAST_CORRELATION * LEAST_CORRELATION:
                return math.nan, math.nan
            unexplained = variance * (1.0 - explained) / (PATCH_SIZE - 3)
            return shift, math.sqrt(unexplained / information) / gain
    return math.nan, math.nan


@kernel
def match(
    left: np.ndarray, left_width: int, left_height: int, right: np.ndarray, right_width: int, right_height: int,
    M: np.ndarray, t: np.ndarray, u: np.ndarray, v: np.ndarray, idepth: np.ndarray,
    found: np.ndarray, reach: np.ndarray, sigma: np.ndarray,
) -> None:  # fmt: skip
    """Find points in the right image, to a fraction of a pixel.

    Args:
        left, right: flat float32 images.
        left_width, left_height, right_width, right_height: of them.
        M, t: as of `correlations`.
        u, v: (n,) float32 left pixels.
        idepth: (n,) float64 inverse depths with which the search begins, 1/m.
        found: (n,) float64 output: inverse depth, 1/m; nan where the point is not found.
        reach: (n,) float64 output: pixels by which the point moves in the right image per 1/m.
        sigma: (n,) float64 output: standard deviation of the place that was found, by the noise of the images; pixels
            along the line.
    """
    warp = warp_of(M, t)
    patch, derivative = np.empty(PATCH_SIZE, np.float32), np.empty(PATCH_SIZE, np.float32)
    for i in range(u.size):
        found[i] = np.nan
        a, b = float(u[i]), float(v[i])
        x, y, z, z_inverse = warp_point(warp, a, b, idepth[i])
        if not (z > 0.0 and _inside(a, b, left_width, left_height)):
            continue
        line_x, line_y = epipolar_direction(warp, x, y)
        length = math.sqrt(line_x * line_x + line_y * line_y)
        reach[i] = length * z_inverse
        line_x, line_y = line_x / length, line_y / length
        mean, squares = _take(left, left_width, a, b, patch)
        if squares < PATCH_SIZE * LEAST_CONTRAST * LEAST_CONTRAST:
            continue
        along_u, along_v = _left_direction(warp, line_x, line_y)
        information, before = _derivative(left, left_width, a, b, along_u, along_v, patch, mean, squares, derivative)
        if information < FLAT * before or information < FLAT:
            continue
        shift, sigma[i] = _shift(
            right, right_width, right_height, warp, x, y, line_x, line_y, patch, mean, squares, derivative, information
        )  # fmt: skip
        if not math.isnan(shift):
            along_x = line_x * line_x > line_y * line_y  # the better conditioned coordinate
            found[i] = idepth_at(warp, a, b, x + shift * line_x, y + shift * line_y, along_x)
