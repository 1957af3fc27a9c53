# SPDX-License-Identifier: BSD-3-Clause
"""Kernels that align points with normal distributions by Gauss-Newton."""

import math
from typing import Tuple

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel

GATE = 9.0  # squared Mahalanobis distance at which the weight of a point is a quarter
CLOSE_M, CLOSE_RAD = 1e-5, 1e-6  # steps that are shorter end the iterations


@kernel
def align_points(
    points: np.ndarray,
    distributions: np.ndarray,
    origin: np.ndarray,
    cell_m: float,
    start: np.ndarray,
    prior_pose: np.ndarray,
    prior: np.ndarray,
    widths: np.ndarray,
    iterations: int,
) -> Tuple[np.ndarray, np.ndarray, np.ndarray, float, float]:
    """The pose that maximises the likelihood of points: Gauss-Newton with the weights of Geman and McClure.

    Each residual is e = T p - mean of the cell that T p is in, with the information of that cell; x, y and yaw of the
    pose are changed in the frame of the field. The distributions are first taken to be wider than they are, so that
    the pose is found from further away.

    Args:
        points: (n, 2) in the frame of the robot, metres.
        distributions: (rows, columns, 6) as `refresh_distributions` makes them.
        origin: (2,) x, y of the corner of cell [0, 0].
        cell_m: its size.
        start: (3,) first guess x, y, yaw in the frame of the field.
        prior_pose: (3,) what is known of the pose without the points.
        prior: (3, 3) its information in the frame of the field.
        widths: (w,) factors of the standard deviations, one after the other, the last one being 1.
        iterations: at most so many with each width.

    Returns:
        Pose (3,); (3, 3) information of the points; (3, 3) sum of g g' over the points, g being the gradient of each;
        share of the points with a small residual; share of the points that are in a cell with a distribution.
    """
    pose = start.copy()
    information, outer = np.zeros((3, 3)), np.zeros((3, 3))
    fit, seen = 0.0, 0.0
    for width in widths:
        scale = 1.0 / (width * width)
        for _ in range(iterations):
            gradient = np.zeros(3)
            information[:] = 0.0
            outer[:] = 0.0
            fit, seen = _linearize(points, distributions, origin, cell_m, pose, scale, gradient, information, outer)
            difference = pose - prior_pose
            difference[2] = math.pi - (math.pi - difference[2]) % (2.0 * math.pi)
            step = np.linalg.solve(information + prior, -gradient - prior @ difference)
            pose += step
            if max(abs(step[0]), abs(step[1])) < CLOSE_M and abs(step[2]) < CLOSE_RAD:
                break
    pose[2] = math.pi - (math.pi - pose[2]) % (2.0 * math.pi)
    return pose, information, outer, fit, seen


@kernel
def _linearize(
    points: np.ndarray,
    distributions: np.ndarray,
    origin: np.ndarray,
    cell_m: float,
    pose: np.ndarray,
    scale: float,
    gradient: np.ndarray,
    information: np.ndarray,
    outer: np.ndarray,
) -> Tuple[float, float]:
    rows, columns = distributions.shape[:2]
    c, s = math.cos(pose[2]), math.sin(pose[2])
    near, seen = 0, 0
    for k in range(len(points)):
        px, py = points[k, 0], points[k, 1]
        rx, ry = c * px - s * py, s * px + c * py
        x, y = rx + pose[0], ry + pose[1]
        column = math.floor((x - origin[0]) / cell_m)
        row = math.floor((y - origin[1]) / cell_m)
        if row < 0 or column < 0 or row >= rows or column >= columns:
            continue
        cell = distributions[row, column]
        if cell[5] == 0.0:
            continue
        seen += 1
        ex, ey = x - cell[0], y - cell[1]
        a, b, d = scale * cell[2], scale * cell[3], scale * cell[4]
        gx, gy = a * ex + b * ey, b * ex + d * ey
        m2 = ex * gx + ey * gy
        near += m2 < GATE
        root = GATE / (GATE + m2)
        w = root * root
        # derivative by yaw: (-ry, rx)
        gt = -ry * gx + rx * gy
        ax, ay = -ry * a + rx * b, -ry * b + rx * d
        gradient[0] += w * gx
        gradient[1] += w * gy
        gradient[2] += w * gt
        information[0, 0] += w * a
        information[0, 1] += w * b
        information[1, 1] += w * d
        information[0, 2] += w * ax
        information[1, 2] += w * ay
        information[2, 2] += w * (-ry * ax + rx * ay)
        outer[0, 0] += w * w * gx * gx
        outer[0, 1] += w * w * gx * gy
        outer[0, 2] += w * w * gx * gt
        outer[1, 1] += w * w * gy * gy
        outer[1, 2] += w * w * gy * gt
        outer[2, 2] += w * w * gt * gt
    for i in range(3):
        for j in range(i):
            information[i, j] = information[j, i]
            outer[i, j] = outer[j, i]
    total = max(len(points), 1)
    return near / total, seen / total
