# SPDX-License-Identifier: BSD-3-Clause
"""Kernels that tell what moves: points where rays have passed before, and nothing has ever been hit."""

import math

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel

FEWEST_PASSES = 2  # rays that make a cell free
BEFORE_END = 1.5  # cells before the end of a ray, which are not free: the surface may begin there
MOST = 255


@kernel
def mark_hits(points: np.ndarray, hits: np.ndarray, origin: np.ndarray, cell_m: float) -> None:
    """Count points (n, 2) in the cells that they are in; hits (rows, columns) uint8, changed."""
    rows, columns = hits.shape
    for k in range(len(points)):
        column = math.floor((points[k, 0] - origin[0]) / cell_m)
        row = math.floor((points[k, 1] - origin[1]) / cell_m)
        if row >= 0 and column >= 0 and row < rows and column < columns and hits[row, column] < MOST:
            hits[row, column] += 1


@kernel
def mark_passes(points: np.ndarray, eye: np.ndarray, passes: np.ndarray, origin: np.ndarray, cell_m: float) -> None:
    """Count the cells that rays from the eye (2,) to points (n, 2) pass; passes (rows, columns) uint8, changed."""
    rows, columns = passes.shape
    for k in range(len(points)):
        dx, dy = points[k, 0] - eye[0], points[k, 1] - eye[1]
        length = math.sqrt(dx * dx + dy * dy)
        steps = int(length / cell_m - BEFORE_END)
        if steps < 1:
            continue
        sx, sy = dx * cell_m / length, dy * cell_m / length
        for step in range(steps):
            column = math.floor((eye[0] + step * sx - origin[0]) / cell_m)
            row = math.floor((eye[1] + step * sy - origin[1]) / cell_m)
            if row < 0 or column < 0 or row >= rows or column >= columns:
                break
            if passes[row, column] < MOST:
                passes[row, column] += 1


@kernel
def in_free_space(
    points: np.ndarray, hits: np.ndarray, passes: np.ndarray, origin: np.ndarray, cell_m: float
) -> np.ndarray:
    """Whether each point (n, 2) is where rays have passed, and no cell there or around was hit, (n,) bool."""
    rows, columns = hits.shape
    found = np.zeros(len(points), np.bool_)
    for k in range(len(points)):
        column = math.floor((points[k, 0] - origin[0]) / cell_m)
        row = math.floor((points[k, 1] - origin[1]) / cell_m)
        if row < 1 or column < 1 or row >= rows - 1 or column >= columns - 1:
            continue
        if passes[row, column] < FEWEST_PASSES:
            continue
        is_free = True
        for i in range(row - 1, row + 2):
            for j in range(column - 1, column + 2):
                if hits[i, j] > 0:
                    is_free = False
        found[k] = is_free
    return found
