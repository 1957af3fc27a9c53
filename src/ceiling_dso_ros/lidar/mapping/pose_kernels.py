# SPDX-License-Identifier: BSD-3-Clause
"""Kernels that relate poses to landmarks."""

import math
from typing import Tuple

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel
from ceiling_dso_ros.lidar.mapping.landmark_kernels import NOTHING, cell_of

SUMS = 9  # of a keyframe and a landmark: 1, g, g g, s, s s, g s, e, e g, e s
GATE = 3.5  # standard deviations: points that are further from a line are not on it


@kernel
def sum_groups(
    placed: np.ndarray,
    first: np.ndarray,
    poses: np.ndarray,
    landmarks: np.ndarray,
    origin: np.ndarray,
    cell_m: float,
    rows: int,
    columns: int,
    lines: np.ndarray,
    variances: np.ndarray,
) -> Tuple[np.ndarray, np.ndarray]:
    """Sums over the points that a keyframe has on a landmark.

    Of each point these count: its distance e from the line, its place s along it, and the derivative g of e by the yaw
    of its keyframe, with the weight 1 / variance.

    Args:
        placed: (P, 2) points in the map.
        first: (K + 1,) where those of each keyframe begin.
        poses: (K, 3).
        landmarks: (cells,) as `choose_windows` gives them.
        origin, cell_m, rows, columns: of the cells.
        lines: (cells, 6) as `fit_lines` gives them.
        variances: (cells,) across the lines, 0 for landmarks that are not used.

    Returns:
        (G, 2) int32 keyframe and landmark of each pair that has points, by increasing keyframe; (G, SUMS).
    """
    capacity = min(len(placed), 4096)
    members = np.empty((capacity, 2), np.int32)
    sums = np.zeros((capacity, SUMS))
    slots = np.full(len(landmarks), NOTHING, np.int32)
    used = 0
    for k in range(len(poses)):
        begin = used
        for i in range(first[k], first[k + 1]):
            x, y = placed[i, 0], placed[i, 1]
            cell = cell_of(x, y, origin, cell_m, rows, columns)
            if cell == NOTHING or landmarks[cell] == NOTHING:
                continue
            landmark = landmarks[cell]
            variance = variances[landmark]
            if variance == 0.0:
                continue
            line = lines[landmark]
            dx, dy = x - line[0], y - line[1]
            e = line[2] * dx + line[3] * dy
            if e * e > GATE * GATE * variance:
                continue
            s = line[2] * dy - line[3] * dx
            g = line[3] * (x - poses[k, 0]) - line[2] * (y - poses[k, 1])
            if slots[landmark] == NOTHING:
                if used == capacity:
                    capacity = 2 * capacity
                    more = np.empty((capacity, 2), np.int32)
                    more[:used] = members
                    members = more
                    larger = np.zeros((capacity, SUMS))
                    larger[:used] = sums
                    sums = larger
                slots[landmark] = used
                members[used, 0], members[used, 1] = k, landmark
                used += 1
            w = 1.0 / variance
            into = sums[slots[landmark]]
            into[0] += w
            into[1] += w * g
            into[2] += w * g * g
            into[3] += w * s
            into[4] += w * s * s
            into[5] += w * g * s
            into[6] += w * e
            into[7] += w * e * g
            into[8] += w * e * s
        for group in range(begin, used):
            slots[members[group, 1]] = NOTHING
    return members[:used], sums[:used]


@kernel
def localise(
    points: np.ndarray,
    landmarks: np.ndarray,
    origin: np.ndarray,
    cell_m: float,
    rows: int,
    columns: int,
    lines: np.ndarray,
    variances: np.ndarray,
    start: np.ndarray,
    prior: np.ndarray,
    gates: np.ndarray,
) -> Tuple[np.ndarray, np.ndarray, int]:
    """The pose of one scan in a map of landmarks, by Gauss-Newton from a first guess, which has the information prior.

    Args:
        points: (n, 2) seen from the scan.
        landmarks, origin, cell_m, rows, columns, lines, variances: as in `sum_groups`.
        start: (3,) the first guess.
        prior: (3, 3) its information.
        gates: (iterations,) standard deviations within which points count, one after the other.

    Returns:
        (3,) pose, (3, 3) information of the points, number of the points that count.
    """
    pose = start.copy()
    H = np.zeros((3, 3))
    count = 0
    for gate in gates:
        H[:] = 0.0
        b = np.zeros(3)
        count = 0
        c, s = math.cos(pose[2]), math.sin(pose[2])
        for i in range(len(points)):
            rx, ry = c * points[i, 0] - s * points[i, 1], s * points[i, 0] + c * points[i, 1]
            x, y = rx + pose[0], ry + pose[1]
            cell = cell_of(x, y, origin, cell_m, rows, columns)
            if cell == NOTHING or landmarks[cell] == NOTHING:
                continue
            variance = variances[landmarks[cell]]
            if variance == 0.0:
                continue
            line = lines[landmarks[cell]]
            nx, ny = line[2], line[3]
            e = nx * (x - line[0]) + ny * (y - line[1])
            if e * e > gate * gate * variance:
                continue
            g = ny * rx - nx * ry
            w = 1.0 / variance
            count += 1
            H[0, 0] += w * nx * nx
            H[0, 1] += w * nx * ny
            H[1, 1] += w * ny * ny
            H[0, 2] += w * nx * g
            H[1, 2] += w * ny * g
            H[2, 2] += w * g * g
            b[0] += w * nx * e
            b[1] += w * ny * e
            b[2] += w * g * e
        H[1, 0], H[2, 0], H[2, 1] = H[0, 1], H[0, 2], H[1, 2]
        pose += np.linalg.solve(H + prior, -b - prior @ (pose - start))
    return pose, H, count
