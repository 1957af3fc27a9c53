# SPDX-License-Identifier: BSD-3-Clause
"""Kernels that build the likelihood field of a submap from points.

Each cell of the coarse grid has a normal distribution, of the points in it and in the eight cells around it (P. Biber,
W. Strasser, "The normal distributions transform", IROS 2003). Along a line of points, the distribution says where the
grid ends and not where the robot is: there its information is set to zero.
"""

import math

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel

LEAST_POINTS = 4  # of a distribution
LINE_RATIO = 8.0  # of the variances along and across: beyond it, the points are those of a line
LARGEST_SIGMA_M = 0.12  # across: broader distributions are those of clutter
SHORTEST_LINE_M = 0.03  # standard deviation along it; else a line's direction is that of the noise


@kernel
def add_to_statistics(points: np.ndarray, statistics: np.ndarray, origin: np.ndarray, cell_m: float) -> np.ndarray:
    """Add points to the sums of their cells: count, x, y, xx, xy, yy.

    Args:
        points: (n, 2) in the frame of the submap, metres.
        statistics: (rows, columns, 6) float64, changed.
        origin: (2,) x, y of the corner of cell [0, 0].
        cell_m: its size.

    Returns:
        (m, 2) int32 row and column of the cells that got points, those at the border left out.
    """
    rows, columns = statistics.shape[:2]
    touched = np.empty((len(points), 2), np.int32)
    used = 0
    for k in range(len(points)):
        column = math.floor((points[k, 0] - origin[0]) / cell_m)
        row = math.floor((points[k, 1] - origin[1]) / cell_m)
        if row < 2 or column < 2 or row >= rows - 2 or column >= columns - 2:
            continue
        x, y = points[k, 0], points[k, 1]
        cell = statistics[row, column]
        cell[0] += 1.0
        cell[1] += x
        cell[2] += y
        cell[3] += x * x
        cell[4] += x * y
        cell[5] += y * y
        touched[used, 0], touched[used, 1] = row, column
        used += 1
    return touched[:used]


@kernel
def refresh_distributions(
    statistics: np.ndarray,
    touched: np.ndarray,
    marks: np.ndarray,
    mark: int,
    smallest_sigma_m: float,
    distributions: np.ndarray,
) -> None:
    """Compute the distributions of all cells that touch one with new points.

    Args:
        statistics: (rows, columns, 6) float64.
        touched: (m, 2) int32 as `add_to_statistics` gives them.
        marks: (rows, columns) int32, changed: a cell with `mark` has been computed.
        mark: the number of this call.
        smallest_sigma_m: of a distribution.
        distributions: (rows, columns, 6) float32, changed: mean x, y, information xx, xy, yy, and 1 where there is one.
    """
    for k in range(len(touched)):
        for row in range(touched[k, 0] - 1, touched[k, 0] + 2):
            for column in range(touched[k, 1] - 1, touched[k, 1] + 2):
                if marks[row, column] != mark:
                    marks[row, column] = mark
                    _refresh(statistics, row, column, smallest_sigma_m, distributions[row, column])


@kernel
def _refresh(statistics: np.ndarray, row: int, column: int, smallest_sigma_m: float, out: np.ndarray) -> None:
    n = sx = sy = sxx = sxy = syy = 0.0
    for i in range(row - 1, row + 2):
        for j in range(column - 1, column + 2):
            cell = statistics[i, j]
            n += cell[0]
            sx += cell[1]
            sy += cell[2]
            sxx += cell[3]
            sxy += cell[4]
            syy += cell[5]
    out[5] = 0.0
    if n < LEAST_POINTS:
        return
    mx, my = sx / n, sy / n
    smallest = smallest_sigma_m * smallest_sigma_m
    # a few points have less spread than their surface: as if four more had the smallest one
    a = (sxx - n * mx * mx + 4.0 * smallest) / n
    b = (sxy - n * mx * my) / n
    c = (syy - n * my * my + 4.0 * smallest) / n
    half, difference = 0.5 * (a + c), 0.5 * (a - c)
    root = math.sqrt(difference * difference + b * b)
    along, across = half + root, max(half - root, smallest)
    if across > LARGEST_SIGMA_M * LARGEST_SIGMA_M:
        return
    is_line = along > LINE_RATIO * across
    if is_line and along < SHORTEST_LINE_M * SHORTEST_LINE_M:
        return
    # the normal: the direction across
    angle = 0.5 * math.atan2(2.0 * b, a - c) + 0.5 * math.pi
    nx, ny = math.cos(angle), math.sin(angle)
    p = 1.0 / across
    q = 0.0 if is_line else 1.0 / along
    out[0], out[1] = mx, my
    out[2] = p * nx * nx + q * ny * ny
    out[3] = (p - q) * nx * ny
    out[4] = p * ny * ny + q * nx * nx
    out[5] = 1.0


@kernel
def stamp_raster(points: np.ndarray, raster: np.ndarray, origin: np.ndarray, cell_m: float, sigma_m: float) -> None:
    """Draw points into a raster of likelihoods: the largest exp(-d^2 / 2 sigma^2) of all points counts.

    Args:
        points: (n, 2) in the frame of the submap, metres.
        raster: (rows, columns) uint8, 255 for the likelihood 1, changed.
        origin: (2,) x, y of the corner of cell [0, 0].
        cell_m: its size.
        sigma_m: of a point.
    """
    rows, columns = raster.shape
    reach = math.ceil(2.5 * sigma_m / cell_m)
    factor = -0.5 / (sigma_m * sigma_m)
    for k in range(len(points)):
        u, v = (points[k, 0] - origin[0]) / cell_m, (points[k, 1] - origin[1]) / cell_m
        column, row = math.floor(u), math.floor(v)
        if row < reach or column < reach or row >= rows - reach or column >= columns - reach:
            continue
        if raster[row, column] > 250:
            continue  # another point is there already
        for i in range(row - reach, row + reach + 1):
            for j in range(column - reach, column + reach + 1):
                dx, dy = (j + 0.5 - u) * cell_m, (i + 0.5 - v) * cell_m
                value = int(255.0 * math.exp(factor * (dx * dx + dy * dy)))
                if value > raster[i, j]:
                    raster[i, j] = value
