# SPDX-License-Identifier: BSD-3-Clause
"""Kernels that turn ranges into points."""

import math
from typing import Tuple

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel

WIDEST_M = 0.6  # between two points of one surface
GRAZING = 4.0  # times the distance of two points on a wall that faces the laser


@kernel
def undistorted_points(
    ranges: np.ndarray, geometry: np.ndarray, mount: np.ndarray, motion: np.ndarray
) -> Tuple[np.ndarray, np.ndarray]:
    """Points of a scan in base_link at the stamp of its first ray, as if all rays had been cast then.

    Ray k is cast t = k time_increment later. By then the base has driven an arc, so what it sees is seen from there:
    p = exp(t v + t^2 a / 2) (mount r_k), with the twist v at the stamp and its change a.

    Args:
        ranges: (R,) float32 metres, NaN where there is no return.
        geometry: (3,) angle_min, angle_increment, time_increment.
        mount: (2, 3) of the laser's x, y and 1 to those of base_link.
        motion: (2, 3) twist at the stamp, m/s ahead, m/s left, rad/s; and its change per second.

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
        half = 0.5 * t * t
        turn = motion[0, 2] * t + motion[1, 2] * half
        c, s = math.cos(turn), math.sin(turn)
        if abs(turn) > 1e-6:
            a, b = s / turn, (1.0 - c) / turn
        else:
            a, b = 1.0, 0.5 * turn
        dx, dy = motion[0, 0] * t + motion[1, 0] * half, motion[0, 1] * t + motion[1, 1] * half
        points[used, 0] = c * bx - s * by + a * dx - b * dy
        points[used, 1] = s * bx + c * by + b * dx + a * dy
        rays[used] = k
        used += 1
    return points[:used], rays[:used]


@kernel
def densified(
    points: np.ndarray, rays: np.ndarray, eye: np.ndarray, increment_rad: float, spacing_m: float
) -> np.ndarray:
    """Points with others between those of neighbouring rays, where these are likely to be on one surface.

    That is where two points are no further from each other than on a wall which the rays meet at 15 degrees.

    Args:
        points: (n, 2) in the order of their rays.
        rays: (n,) int32.
        eye: (2,) the laser's place.
        increment_rad: from ray to ray, positive.
        spacing_m: of the points that are put between.

    Returns:
        (m, 2), the points themselves first.
    """
    capacity = 2 * len(points) + 16
    dense = np.empty((capacity, 2))
    used = len(points)
    dense[:used] = points
    for k in range(len(points) - 1):
        if rays[k + 1] != rays[k] + 1:
            continue
        dx, dy = points[k + 1, 0] - points[k, 0], points[k + 1, 1] - points[k, 1]
        gap = math.sqrt(dx * dx + dy * dy)
        reach = math.sqrt((points[k, 0] - eye[0]) ** 2 + (points[k, 1] - eye[1]) ** 2)
        between = int(gap / spacing_m)
        if gap > WIDEST_M or gap > GRAZING * reach * increment_rad or between < 1:
            continue
        for j in range(between):
            if used == capacity:
                capacity = 2 * capacity
                more = np.empty((capacity, 2))
                more[:used] = dense
                dense = more
            share = (j + 1.0) / (between + 1.0)
            dense[used, 0], dense[used, 1] = points[k, 0] + share * dx, points[k, 1] + share * dy
            used += 1
    return dense[:used]
