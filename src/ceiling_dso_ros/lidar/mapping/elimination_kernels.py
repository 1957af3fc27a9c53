# SPDX-License-Identifier: BSD-3-Clause
"""Kernels that eliminate the landmarks from the normal equations of poses and map."""

import math

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel

LEAST_INFORMATION = 1e-9  # of a landmark, so that a single point leaves its direction open without a division by zero


@kernel
def eliminate_landmarks(
    members: np.ndarray, sums: np.ndarray, lines: np.ndarray, information: np.ndarray, gradient: np.ndarray
) -> None:
    """Add what the points say of the poses, whatever the lines are that they are on.

    A line has two variables, its distance d and its angle a: e = n (q - m) - d - a s. With the derivatives P of e by a
    pose and L by its line, the reduced system is P'P - P'L (L'L)^-1 L'P.

    Args:
        members: (G, 2) keyframe and landmark, sorted by landmark.
        sums: (G, SUMS) as `sum_groups` gives them.
        lines: (cells, 6) as `fit_lines` gives them.
        information: (3 K, 3 K), changed; x, y, yaw of each keyframe.
        gradient: (3 K,), changed.
    """
    count = len(members)
    begin = 0
    across = np.empty((count, 3, 2))  # P'L, and then times the root of (L'L)^-1
    while begin < count:
        end = begin
        n = s = ss = e = es = 0.0
        while end < count and members[end, 1] == members[begin, 1]:
            n += sums[end, 0]
            s += sums[end, 3]
            ss += sums[end, 4]
            e += sums[end, 6]
            es += sums[end, 8]
            end += 1
        nx, ny = lines[members[begin, 1], 2], lines[members[begin, 1], 3]
        # (L'L)^-1 = R R' with the upper triangular R
        n += LEAST_INFORMATION
        ss += LEAST_INFORMATION
        r11 = 1.0 / math.sqrt(ss)
        r00 = 1.0 / math.sqrt(max(n - s * s / ss, LEAST_INFORMATION))
        r10 = -s / ss * r00
        # columns of the root: (r00, r10) and (0, r11); L'e = (-e, -es)
        u0 = -(r00 * e + r10 * es)
        u1 = -(r11 * es)
        for group in range(begin, end):
            k = 3 * members[group, 0]
            own = sums[group]
            for i in range(3):
                p = nx if i == 0 else ny
                direct, along = (-p * own[0], -p * own[3]) if i < 2 else (-own[1], -own[5])
                across[group, i, 0] = direct * r00 + along * r10
                across[group, i, 1] = along * r11
            information[k, k] += nx * nx * own[0]
            information[k, k + 1] += nx * ny * own[0]
            information[k + 1, k] += nx * ny * own[0]
            information[k + 1, k + 1] += ny * ny * own[0]
            information[k, k + 2] += nx * own[1]
            information[k + 2, k] += nx * own[1]
            information[k + 1, k + 2] += ny * own[1]
            information[k + 2, k + 1] += ny * own[1]
            information[k + 2, k + 2] += own[2]
            gradient[k] += nx * own[6]
            gradient[k + 1] += ny * own[6]
            gradient[k + 2] += own[7]
            for i in range(3):
                gradient[k + i] -= across[group, i, 0] * u0 + across[group, i, 1] * u1
        for one in range(begin, end):
            k = 3 * members[one, 0]
            for other in range(begin, end):
                m = 3 * members[other, 0]
                for i in range(3):
                    a0, a1 = across[one, i, 0], across[one, i, 1]
                    for j in range(3):
                        information[k + i, m + j] -= a0 * across[other, j, 0] + a1 * across[other, j, 1]
        begin = end
