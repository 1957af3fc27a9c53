# SPDX-License-Identifier: BSD-3-Clause
"""Noise of an image, and its smoothing.

Interpolation averages independent noise: most between the pixels, not at all on them. The photometric error of a point
is therefore smallest where the point falls between pixels, whatever the scene shows. For noise of standard deviation s
and a gradient g this moves the point by up to (s / g)^2 / 4 pixels, all points of an image alike. In a smoothed image
the noise of neighbouring pixels is nearly the same, and interpolation changes it little.
"""

import math
from typing import Optional

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel, kernel_noalias

CELL = 16  # pixels in a row of the square cells in which the noise is measured
CLIPPED = 8.0  # darker cells, and those as near to white, hide their noise
CALMEST = 0.3  # share of the cells that are taken to show noise alone, and no texture of the scene
# Of a Gaussian with a standard deviation of 0.8 pixels: neighbours then share two thirds of their noise.
TAPS = np.exp(-0.5 * (np.arange(-2, 3) / 0.8) ** 2)
TAPS = (TAPS / TAPS.sum()).astype(np.float32)
REACH = 2


def noise_level(image: np.ndarray) -> Optional[float]:
    """Standard deviation of an image's noise in grey levels, None where it is too dark or too bright to show any.

    By the method of J. Immerkaer, "Fast noise variance estimation", CVIU 1996, in the calmest cells.

    Args:
        image: (height, width) uint8 or float32, grey levels 0..255.
    """
    levels = cell_noise(np.ascontiguousarray(image, np.float32))
    shown = levels[levels >= 0.0]
    return float(np.quantile(shown, CALMEST)) if shown.size else None


@kernel
def cell_noise(image: np.ndarray) -> np.ndarray:
    """Noise of each square cell of an image (height, width) float32, -1 where it is hidden; flat float64.

    The second difference of second differences is blind to planes and edges along the axes; its gain for noise is 6.
    """
    rows, columns = (image.shape[0] - 2) // CELL, (image.shape[1] - 2) // CELL
    result = np.empty(rows * columns)
    for cell in range(rows * columns):
        top, left = 1 + cell // columns * CELL, 1 + cell % columns * CELL
        total, mean = 0.0, 0.0
        for y in range(top, top + CELL):
            for x in range(left, left + CELL):
                corners = image[y - 1, x - 1] + image[y - 1, x + 1] + image[y + 1, x - 1] + image[y + 1, x + 1]
                sides = image[y - 1, x] + image[y + 1, x] + image[y, x - 1] + image[y, x + 1]
                difference = corners - 2.0 * sides + 4.0 * image[y, x]
                total += difference * difference
                mean += image[y, x]
        mean /= CELL * CELL
        result[cell] = math.sqrt(total / (CELL * CELL)) / 6.0 if CLIPPED < mean < 255.0 - CLIPPED else -1.0
    return result


@kernel_noalias
def smooth_image(image: np.ndarray, rows: np.ndarray, smoothed: np.ndarray) -> None:
    """Convolve an image with TAPS in both directions; beyond its edges it goes on as it ends.

    Args:
        image: (height, width) float32.
        rows: (height, width) float32, scratch.
        smoothed: (height, width) float32, the result.
    """
    height, width = image.shape
    for y in range(height):
        above, over, under, below = max(y - 2, 0), max(y - 1, 0), min(y + 1, height - 1), min(y + 2, height - 1)
        for x in range(width):
            rows[y, x] = (
                TAPS[0] * (image[above, x] + image[below, x])
                + TAPS[1] * (image[over, x] + image[under, x])
                + TAPS[2] * image[y, x]
            )
        for x in range(REACH, width - REACH):
            smoothed[y, x] = (
                TAPS[0] * (rows[y, x - 2] + rows[y, x + 2])
                + TAPS[1] * (rows[y, x - 1] + rows[y, x + 1])
                + TAPS[2] * rows[y, x]
            )
        for x in (0, 1, width - 2, width - 1):
            total = np.float32(0.0)
            for k in range(-REACH, REACH + 1):
                total += TAPS[k + REACH] * rows[y, min(max(x + k, 0), width - 1)]
            smoothed[y, x] = total
