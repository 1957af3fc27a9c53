# SPDX-License-Identifier: BSD-3-Clause
"""Kernels that cut walls into short straight pieces, the landmarks.

The plane is divided into small cells; a landmark is a line through the points of 2 x 2 of them. Each cell belongs to
that one of its four windows which has most points: so a wall on the border of two cells is one landmark and not two.
"""

import math

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel

NOTHING = -1  # landmark of a cell without points


@kernel
def cell_of(x: float, y: float, origin: np.ndarray, cell_m: float, rows: int, columns: int) -> int:
    """Index of the cell at x, y; NOTHING beyond the border, of which the outermost cells are part."""
    column, row = math.floor((x - origin[0]) / cell_m), math.floor((y - origin[1]) / cell_m)
    if row < 1 or column < 1 or row >= rows - 1 or column >= columns - 1:
        return NOTHING
    return row * columns + column


@kernel
def place_points(points: np.ndarray, first: np.ndarray, poses: np.ndarray, placed: np.ndarray) -> None:
    """Points in the map.

    Args:
        points: (P, 2) of all keyframes, seen from themselves.
        first: (K + 1,) where those of each keyframe begin.
        poses: (K, 3).
        placed: (P, 2), changed.
    """
    for k in range(len(poses)):
        c, s = math.cos(poses[k, 2]), math.sin(poses[k, 2])
        for i in range(first[k], first[k + 1]):
            placed[i, 0] = c * points[i, 0] - s * points[i, 1] + poses[k, 0]
            placed[i, 1] = s * points[i, 0] + c * points[i, 1] + poses[k, 1]


@kernel
def choose_windows(placed: np.ndarray, origin: np.ndarray, cell_m: float, rows: int, columns: int) -> np.ndarray:
    """Landmark of each cell, (rows * columns,) int32: the index of the first cell of its window, or NOTHING."""
    counts = np.zeros(rows * columns, np.int32)
    for i in range(len(placed)):
        cell = cell_of(placed[i, 0], placed[i, 1], origin, cell_m, rows, columns)
        if cell != NOTHING:
            counts[cell] += 1
    landmarks = np.full(rows * columns, NOTHING, np.int32)
    for row in range(1, rows - 1):
        for column in range(1, columns - 1):
            cell = row * columns + column
            if counts[cell] == 0:
                continue
            most = 0
            for i in range(2):
                for j in range(2):
                    window = cell - i * columns - j
                    count = counts[window] + counts[window + 1] + counts[window + columns]
                    count += counts[window + columns + 1]
                    if count > most:
                        most = count
                        landmarks[cell] = window
    return landmarks


@kernel
def add_to_lines(
    placed: np.ndarray,
    landmarks: np.ndarray,
    origin: np.ndarray,
    cell_m: float,
    rows: int,
    columns: int,
    lines: np.ndarray,
    spread_m: float,
    sums: np.ndarray,
) -> None:
    """Add points to the sums of their landmarks: weight, x, y, xx, xy, yy from the middle of the window.

    Args:
        placed: (P, 2) points in the map.
        landmarks: (cells,) as `choose_windows` gives them.
        origin, cell_m, rows, columns: of the cells.
        lines: (cells, 6) as `fit_lines` gives them.
        spread_m: points that are so far from their line have a quarter of the weight (Geman and McClure); inf for
            equal weights.
        sums: (cells, 6), changed.
    """
    for i in range(len(placed)):
        cell = cell_of(placed[i, 0], placed[i, 1], origin, cell_m, rows, columns)
        if cell == NOTHING or landmarks[cell] == NOTHING:
            continue
        landmark = landmarks[cell]
        x = placed[i, 0] - origin[0] - (landmark % columns + 1) * cell_m
        y = placed[i, 1] - origin[1] - (landmark // columns + 1) * cell_m
        weight = 1.0
        if spread_m < np.inf:
            line = lines[landmark]
            e = line[2] * (placed[i, 0] - line[0]) + line[3] * (placed[i, 1] - line[1])
            root = spread_m * spread_m / (spread_m * spread_m + e * e)
            weight = root * root
        into = sums[landmark]
        into[0] += weight
        into[1] += weight * x
        into[2] += weight * y
        into[3] += weight * x * x
        into[4] += weight * x * y
        into[5] += weight * y * y


@kernel
def fit_lines(sums: np.ndarray, origin: np.ndarray, cell_m: float, columns: int, lines: np.ndarray) -> None:
    """Lines through the points of each landmark.

    Args:
        sums: (cells, 6) as `add_to_lines` makes them.
        origin, cell_m, columns: of the cells.
        lines: (cells, 6), changed: x, y of the middle, normal x, y, variance across, variance along; zeros where there
            are fewer than three points.
    """
    for landmark in range(len(sums)):
        n = sums[landmark, 0]
        if n < 3.0:
            lines[landmark] = 0.0
            continue
        mx, my = sums[landmark, 1] / n, sums[landmark, 2] / n
        a = sums[landmark, 3] / n - mx * mx
        b = sums[landmark, 4] / n - mx * my
        c = sums[landmark, 5] / n - my * my
        half, difference = 0.5 * (a + c), 0.5 * (a - c)
        root = math.sqrt(difference * difference + b * b)
        angle = 0.5 * math.atan2(2.0 * b, a - c) + 0.5 * math.pi
        lines[landmark, 0] = mx + origin[0] + (landmark % columns + 1) * cell_m
        lines[landmark, 1] = my + origin[1] + (landmark // columns + 1) * cell_m
        lines[landmark, 2], lines[landmark, 3] = math.cos(angle), math.sin(angle)
        lines[landmark, 4], lines[landmark, 5] = max(half - root, 0.0), half + root


@kernel
def variances_within(
    placed: np.ndarray,
    landmarks: np.ndarray,
    origin: np.ndarray,
    cell_m: float,
    rows: int,
    columns: int,
    lines: np.ndarray,
    within_m: float,
    found: np.ndarray,
) -> None:
    """Number of points of each landmark near its line, and the sum of their squared distances; found (cells, 2)."""
    for i in range(len(placed)):
        cell = cell_of(placed[i, 0], placed[i, 1], origin, cell_m, rows, columns)
        if cell == NOTHING or landmarks[cell] == NOTHING:
            continue
        line = lines[landmarks[cell]]
        e = line[2] * (placed[i, 0] - line[0]) + line[3] * (placed[i, 1] - line[1])
        if abs(e) < within_m:
            found[landmarks[cell], 0] += 1.0
            found[landmarks[cell], 1] += e * e


@kernel
def count_crossings(
    placed: np.ndarray,
    first: np.ndarray,
    eyes: np.ndarray,
    every: int,
    landmarks: np.ndarray,
    origin: np.ndarray,
    cell_m: float,
    rows: int,
    columns: int,
    lines: np.ndarray,
    clear_m: float,
    found: np.ndarray,
) -> None:
    """Count the keyframes and rays that end on each landmark, and the rays that go through it.

    Args:
        placed: (P, 2) points in the map.
        first: (K + 1,) where those of each keyframe begin.
        eyes: (K, 2) where their rays were cast.
        every: one of so many rays is followed.
        landmarks, origin, cell_m, rows, columns, lines: as in `add_to_lines`.
        clear_m: a ray goes through a line if its end is further behind it.
        found: (cells, 3) int32 keyframes, ends and crossings, changed.
    """
    seen_by = np.full(len(landmarks), NOTHING, np.int32)
    for k in range(len(eyes)):
        for i in range(first[k], first[k + 1]):
            x, y = placed[i, 0], placed[i, 1]
            own = cell_of(x, y, origin, cell_m, rows, columns)
            if own != NOTHING and landmarks[own] != NOTHING:
                landmark = landmarks[own]
                if seen_by[landmark] != k:
                    seen_by[landmark] = k
                    found[landmark, 0] += 1
            if (i - first[k]) % every != 0:
                continue
            if own != NOTHING and landmarks[own] != NOTHING:
                found[landmarks[own], 1] += 1
            dx, dy = x - eyes[k, 0], y - eyes[k, 1]
            steps = int(math.sqrt(dx * dx + dy * dy) / cell_m) + 1
            last = NOTHING
            for step in range(steps):
                t = step / steps
                cell = cell_of(eyes[k, 0] + t * dx, eyes[k, 1] + t * dy, origin, cell_m, rows, columns)
                if cell == NOTHING or landmarks[cell] == NOTHING or landmarks[cell] == last:
                    continue
                landmark = landmarks[cell]
                last = landmark
                line = lines[landmark]
                before = line[2] * (eyes[k, 0] - line[0]) + line[3] * (eyes[k, 1] - line[1])
                behind = line[2] * (x - line[0]) + line[3] * (y - line[1])
                if before * behind >= 0.0 or abs(behind) < clear_m:
                    continue
                s = before / (before - behind)
                there = cell_of(eyes[k, 0] + s * dx, eyes[k, 1] + s * dy, origin, cell_m, rows, columns)
                if there != NOTHING and landmarks[there] == landmark:
                    found[landmark, 2] += 1
