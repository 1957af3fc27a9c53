# SPDX-License-Identifier: BSD-3-Clause
"""Samples of an image and its gradient between pixels. Images are flat float32 arrays, row after row.

A residual compares a pixel of one image with a sample of another. A bilinear sample is too smooth: with the fraction f
of a pixel, its error is half of f (1 - f) times the second derivative. This error does not average out over a residual
pattern that is not symmetric, and shifts all points in the same direction. So where accuracy matters, samples are cubic
along both axes (R. G. Keys, "Cubic convolution interpolation for digital image processing", 1981, with a = -1/2,
without the terms that mix the axes): they need the same twelve pixels as the gradient, the bilinear interpolation of
central differences.
"""

from typing import Tuple

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel_inlined

ONE = np.float32(1.0)
HALF = np.float32(0.5)


@kernel_inlined
def sample(image: np.ndarray, width: int, x: np.float32, y: np.float32) -> np.float32:
    """Bilinear grey value at (x, y); the four neighbours must exist."""
    xi, yi = np.uint32(x), np.uint32(y)
    fx, fy = x - np.float32(xi), y - np.float32(yi)
    p = yi * np.uint32(width) + xi
    q = p + np.uint32(width)
    w11 = fx * fy
    w10 = fy - w11
    w01 = fx - w11
    w00 = ONE - fx - fy + w11
    one = np.uint32(1)
    return w00 * image[p] + w01 * image[p + one] + w10 * image[q] + w11 * image[q + one]


@kernel_inlined
def sample_gradient(
    image: np.ndarray, width: int, x: np.float32, y: np.float32
) -> Tuple[np.float32, np.float32, np.float32]:
    """Cubic grey value and gradient (value, d/dx, d/dy) at (x, y), 1 <= x < width - 2 and likewise y."""
    xi, yi = np.uint32(x), np.uint32(y)
    fx, fy = x - np.float32(xi), y - np.float32(yi)
    w11 = fx * fy
    w10 = fy - w11
    w01 = fx - w11
    w00 = ONE - fx - fy + w11
    one, two, row = np.uint32(1), np.uint32(2), np.uint32(width)
    p = yi * row + xi
    q = p + row
    above, below = p - row, q + row
    a, b, c, d = image[p], image[p + one], image[q], image[q + one]
    left_a, right_b, left_c, right_d = image[p - one], image[p + two], image[q - one], image[q + two]
    above_a, above_b, below_c, below_d = image[above], image[above + one], image[below], image[below + one]
    grad_x = HALF * (w00 * (b - left_a) + w01 * (right_b - a) + w10 * (d - left_c) + w11 * (right_d - c))
    grad_y = HALF * (w00 * (c - above_a) + w01 * (d - above_b) + w10 * (below_c - a) + w11 * (below_d - b))
    beside = w00 * (b + left_a) + w01 * (right_b + a) + w10 * (d + left_c) + w11 * (right_d + c)
    upright = w00 * (c + above_a) + w01 * (d + above_b) + w10 * (below_c + a) + w11 * (below_d + b)
    bend_x, bend_y = fx * (ONE - fx), fy * (ONE - fy)
    linear = w00 * a + w01 * b + w10 * c + w11 * d
    value = (ONE + bend_x + bend_y) * linear - HALF * (bend_x * beside + bend_y * upright)
    return value, grad_x, grad_y
