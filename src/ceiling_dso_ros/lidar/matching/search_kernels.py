# SPDX-License-Identifier: BSD-3-Clause
"""Kernels of the correlative search: E. Olson, "Real-time correlative scan matching", ICRA 2009, by branch and bound.

As in W. Hess et al., "Real-time loop closure in 2D LIDAR SLAM", ICRA 2016, level h of a pyramid has in each cell the
largest likelihood of the 2^h x 2^h cells that begin there. So the score of a place on level h is a bound of the scores
of all places that begin there, and most of them need not be looked at.
"""

from typing import Tuple

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel

NO_PLACE = -1  # angle index of a result where no score is high enough


@kernel
def place_score(level: np.ndarray, columns: np.ndarray, rows: np.ndarray, dx: int, dy: int) -> float:
    """Mean likelihood, 0 to 1, of points at (n,) columns and rows, shifted by dx, dy cells."""
    height, width = level.shape
    total = 0
    for k in range(len(columns)):
        x, y = columns[k] + dx, rows[k] + dy
        if x >= 0 and y >= 0 and x < width and y < height:
            total += level[y, x]
    return total / (255.0 * len(columns))


@kernel
def search_places(
    levels: np.ndarray,
    columns: np.ndarray,
    rows: np.ndarray,
    reach: np.ndarray,
    least_score: float,
    penalties: np.ndarray,
    excluded: np.ndarray,
) -> Tuple[int, int, int, float]:
    """The place with the best score.

    Args:
        levels: (L, height, width) uint8 pyramid of likelihoods.
        columns, rows: (A, n) int32 cells of the points for each angle at the centre of the search.
        reach: (2,) largest shift in columns and in rows.
        least_score: scores that are not higher do not count.
        penalties: (2,) what the score loses at the full reach, and at the first and the last angle, each growing with
            the square of the distance: of two equal places the nearer one is taken.
        excluded: (5,) angle index, dx, dy of a place and the distances (angles, cells) within which no place counts;
            angle index -1 for none.

    Returns:
        Angle index (NO_PLACE if there is none), dx, dy, and the score.
    """
    top = levels.shape[0] - 1
    step = 1 << top
    angles = columns.shape[0]
    across, down = 2 * reach[0] // step + 1, 2 * reach[1] // step + 1
    count = angles * across * down
    scores = np.empty(count)
    for a in range(angles):
        for i in range(down):
            for j in range(across):
                dx, dy = j * step - reach[0], i * step - reach[1]
                scores[(a * down + i) * across + j] = place_score(levels[top], columns[a], rows[a], dx, dy)
    order = np.argsort(-scores)
    best, best_a, best_dx, best_dy = least_score, NO_PLACE, 0, 0
    stack = np.empty((4 * levels.shape[0] + 4, 3), np.int64)
    bounds = np.empty(len(stack))
    middle = max(0.5 * (angles - 1), 0.5)
    for index in order:
        if scores[index] <= best:
            break
        a = index // (across * down)
        rest = index - a * across * down
        turned = (a - 0.5 * (angles - 1)) / middle
        size = 1
        stack[0, 0], stack[0, 1] = (rest % across) * step - reach[0], (rest // across) * step - reach[1]
        stack[0, 2] = top
        bounds[0] = scores[index]
        while size > 0:
            size -= 1
            if bounds[size] <= best:
                continue
            dx, dy, level = stack[size, 0], stack[size, 1], stack[size, 2]
            if level == 0:
                is_excluded = (
                    excluded[0] >= 0
                    and abs(a - excluded[0]) <= excluded[3]
                    and abs(dx - excluded[1]) <= excluded[4]
                    and abs(dy - excluded[2]) <= excluded[4]
                )
                away = (dx / max(reach[0], 1)) ** 2 + (dy / max(reach[1], 1)) ** 2
                score = bounds[size] - penalties[0] * away - penalties[1] * turned * turned
                if score > best and not is_excluded:
                    best, best_a, best_dx, best_dy = score, a, dx, dy
                continue
            half = 1 << (level - 1)
            first = size
            for k in range(4):
                x, y = dx + (k & 1) * half, dy + (k >> 1) * half
                if x > reach[0] or y > reach[1]:
                    continue
                bound = place_score(levels[level - 1], columns[a], rows[a], x, y)
                if bound <= best:
                    continue
                at = size
                while at > first and bounds[at - 1] > bound:  # the best one on top
                    bounds[at] = bounds[at - 1]
                    stack[at] = stack[at - 1]
                    at -= 1
                bounds[at] = bound
                stack[at, 0], stack[at, 1], stack[at, 2] = x, y, level - 1
                size += 1
    return best_a, best_dx, best_dy, best
