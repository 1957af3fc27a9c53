"""Bilinear samples of an image and its gradient. Images are flat float32 arrays, row after row.

The gradient is the bilinear interpolation of central differences, taken from twelve pixels of the image itself: the
same numbers as sampling gradient images, with a third of the memory traffic.
"""

from typing import Tuple

import numpy as np

from ceiling_dso_ros.dso.jit import kernel

ONE = np.float32(1.0)
HALF = np.float32(0.5)


@kernel
def sample(image: np.ndarray, width: int, x: np.float32, y: np.float32) -> np.float32:
    """Grey value at (x, y); the four neighbours must exist."""
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


@kernel
def sample_gradient(
    image: np.ndarray, width: int, x: np.float32, y: np.float32
) -> Tuple[np.float32, np.float32, np.float32]:
    """Grey value and gradient (value, d/dx, d/dy) at (x, y), 1 <= x < width - 2 and likewise y."""
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
    value = w00 * a + w01 * b + w10 * c + w11 * d
    grad_x = HALF * (
        w00 * (b - image[p - one])
        + w01 * (image[p + two] - a)
        + w10 * (d - image[q - one])
        + w11 * (image[q + two] - c)
    )
    grad_y = HALF * (
        w00 * (c - image[above])
        + w01 * (d - image[above + one])
        + w10 * (image[below] - a)
        + w11 * (image[below + one] - b)
    )
    return value, grad_x, grad_y
