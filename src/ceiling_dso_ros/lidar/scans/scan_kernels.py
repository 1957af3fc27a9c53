# SPDX-License-Identifier: BSD-3-Clause
"""Kernels that turn ranges into points."""

import math
from typing import Tuple

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel


@kernel
def undistorted_points(
    ranges: np.ndarray, geometry: np.ndarray, mount: np.ndarray, twist: np.ndarray
) -> Tuple[np.ndarray, np.ndarray]:
    """Points of a scan in base_link at the stamp of its first ray, as if all rays had been cast then.

    Ray k is cast k time_increment later. By then the base has driven the arc of its twist, so what it sees is seen from
    there: p = exp(k dt twist) (mount r_k).

    Args:
        ranges: (R,) float32 metres, NaN where there is no return.
        geometry: (3,) angle_min, angle_increment, time_increment.
        mount: (2, 3) of the laser's x, y and 1 to those of base_link.
        twist: (3,) m/s ahead, m/s left, rad/s.

    Returns:
        (n, 2) float64 points and (n,) int32 indices of their rays.
    """
    count = len(ranges)
    points = np.empty((count, 2))
    rays = np.empty(count, np.int32)
    used = 0
    for k in range(count):
        r = float(ranges[k])
        if not r > 0.0:
            continue
        angle = geometry[0] + k * geometry[1]
        x, y = r * math.cos(angle), r * math.sin(angle)
        bx = mount[0, 0] * x + mount[0, 1] * y + mount[0, 2]
        by = mount[1, 0] * x + mount[1, 1] * y + mount[1, 2]
        t = k * geometry[2]
        turn = twist[2] * t
        c, s = math.cos(turn), math.sin(turn)
        if abs(turn) > 1e-6:
            a, b = s / turn, (1.0 - c) / turn
        else:
            a, b = 1.0, 0.5 * turn
        dx, dy = twist[0] * t, twist[1] * t
        points[used, 0] = c * bx - s * by + a * dx - b * dy
        points[used, 1] = s * bx + c * by + b * dx + a * dy
        rays[used] = k
        used += 1
    return points[:used], rays[:used]
