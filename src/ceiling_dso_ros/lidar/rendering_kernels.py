# SPDX-License-Identifier: BSD-3-Clause
"""Kernels that draw the map."""

import math

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel


@kernel
def cast_rays(
    placed: np.ndarray,
    first: np.ndarray,
    eyes: np.ndarray,
    origin: np.ndarray,
    cell_m: float,
    hits: np.ndarray,
    passes: np.ndarray,
) -> None:
    """Count how often rays end in each cell and how often they pass it.

    Args:
        placed: (P, 2) ends of the rays in the map.
        first: (K + 1,) where those of each scan begin.
        eyes: (K, 2) where they were cast.
        origin: (2,) corner of cell [0, 0].
        cell_m: its size.
        hits, passes: (rows, columns) int32, changed.
    """
    rows, columns = hits.shape
    for k in range(len(eyes)):
        for i in range(first[k], first[k + 1]):
            dx, dy = placed[i, 0] - eyes[k, 0], placed[i, 1] - eyes[k, 1]
            length = math.sqrt(dx * dx + dy * dy)
            end_column = math.floor((placed[i, 0] - origin[0]) / cell_m)
            end_row = math.floor((placed[i, 1] - origin[1]) / cell_m)
            steps = int(length / cell_m) + 1
            last = -1
            for step in range(steps):
                t = step / steps
                column = math.floor((eyes[k, 0] + t * dx - origin[0]) / cell_m)
                row = math.floor((eyes[k, 1] + t * dy - origin[1]) / cell_m)
                is_inside = row >= 0 and column >= 0 and row < rows and column < columns
                is_end = row == end_row and column == end_column
                if is_inside and not is_end and row * columns + column != last:
                    last = row * columns + column
                    passes[row, column] += 1
            if end_row >= 0 and end_column >= 0 and end_row < rows and end_column < columns:
                hits[end_row, end_column] += 1
