# SPDX-License-Identifier: BSD-3-Clause
"""Grey values and gradients between pixels, by their definition and in float64: what the kernels are held against."""

import numpy as np
from scipy.ndimage import map_coordinates


def keys_weights(fraction):
    """(4, N) weights of the pixels at -1, 0, 1, 2 in Keys' cubic convolution with a = -1/2."""
    distance = np.abs(np.array([[-1], [0], [1], [2]]) - fraction)
    near = 1.5 * distance**3 - 2.5 * distance**2 + 1
    far = -0.5 * distance**3 + 2.5 * distance**2 - 4 * distance + 2
    return np.where(distance <= 1, near, far)


def cubic_along_x(image, x, y):
    """Cubic in x, linear in y."""
    column = np.floor(x).astype(int)
    weights = keys_weights(x - column)
    return sum(w * map_coordinates(image, [y, column + k], order=1) for k, w in zip((-1, 0, 1, 2), weights))


def sample(image, x, y):
    """(value, d/dx, d/dy) at pixels (x, y), each (N,)."""
    image, x, y = np.asarray(image, float), np.asarray(x, float), np.asarray(y, float)
    linear = map_coordinates(image, [y, x], order=1)
    value = cubic_along_x(image, x, y) + cubic_along_x(image.T, y, x) - linear
    grad_y, grad_x = np.gradient(image)
    return value, map_coordinates(grad_x, [y, x], order=1), map_coordinates(grad_y, [y, x], order=1)
