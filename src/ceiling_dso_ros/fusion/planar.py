# SPDX-License-Identifier: BSD-3-Clause
"""Rigid motion in the plane, SE(2), and its place in SE(3).

A pose is a (3,) float64 array (x, y, yaw) in metres and radians. Small errors are right-multiplied: a pose with the
error d is `compose(pose, d)`, so d = (forward, left, turn) is seen from the pose itself. Covariances are of that d
unless a name ends in `_odom`.
"""

import math
from typing import Tuple

import numpy as np


def wrap(angle_rad: float) -> float:
    """The same angle in (-pi, pi]."""
    return math.pi - (math.pi - angle_rad) % (2.0 * math.pi)


def rotation(yaw_rad: float) -> np.ndarray:
    """(2, 2) rotation by yaw."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array([[c, -s], [s, c]])


def compose(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """T_x_z of a = T_x_y and b = T_y_z, (3,)."""
    c, s = math.cos(a[2]), math.sin(a[2])
    return np.array([a[0] + c * b[0] - s * b[1], a[1] + s * b[0] + c * b[1], wrap(a[2] + b[2])])


def inverse(a: np.ndarray) -> np.ndarray:
    """T_y_x of a = T_x_y, (3,)."""
    c, s = math.cos(a[2]), math.sin(a[2])
    return np.array([-c * a[0] - s * a[1], s * a[0] - c * a[1], -a[2]])


def between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Pose of b seen from a: T_a_b of T_x_a and T_x_b, (3,)."""
    return compose(inverse(a), b)


def _arc_factors(turn: float) -> Tuple[float, float, float]:
    """(sin t) / t, (1 - cos t) / t and (t - sin t) / t^2, without loss for small t."""
    if abs(turn) < 1e-4:
        return 1.0 - turn * turn / 6.0, 0.5 * turn, turn / 6.0
    return math.sin(turn) / turn, 2.0 * math.sin(0.5 * turn) ** 2 / turn, (turn - math.sin(turn)) / turn**2


def expmap(twist: np.ndarray) -> np.ndarray:
    """The pose reached by driving an arc with constant (forward, left, turn), (3,); exact for any turn."""
    a, b, _ = _arc_factors(twist[2])
    return np.array([a * twist[0] - b * twist[1], b * twist[0] + a * twist[1], wrap(twist[2])])


def logmap(pose: np.ndarray) -> np.ndarray:
    """The arc (forward, left, turn) that leads to the pose, the inverse of `expmap` for |turn| < pi, (3,)."""
    half = 0.5 * wrap(pose[2])
    a = half / math.tan(half) if abs(half) > 1e-9 else 1.0
    return np.array([a * pose[0] + half * pose[1], -half * pose[0] + a * pose[1], 2.0 * half])


def adjoint(pose: np.ndarray) -> np.ndarray:
    """(3, 3) matrix A with compose(pose, d) = compose(A d, pose) for small d."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return np.array([[c, -s, pose[1]], [s, c, -pose[0]], [0.0, 0.0, 1.0]])


def right_jacobian(twist: np.ndarray) -> np.ndarray:
    """(3, 3) derivative of `expmap`: expmap(t + dt) = compose(expmap(t), J dt) for small dt."""
    forward, left, turn = twist
    a, b, c = _arc_factors(turn)
    d = b / turn if abs(turn) > 1e-12 else 0.5
    return np.array([[a, b, c * forward - d * left], [-b, a, d * forward + c * left], [0.0, 0.0, 1.0]])


def rotate_covariance(covariance: np.ndarray, yaw_rad: float) -> np.ndarray:
    """Covariance of (x, y, yaw) in the frame in which the pose has that yaw, (3, 3), from the pose's own."""
    turned = np.eye(3)
    turned[:2, :2] = rotation(yaw_rad)
    return turned @ covariance @ turned.T


def inverse_2x2(matrix: np.ndarray) -> np.ndarray:
    """Inverse of a (2, 2) matrix; LAPACK takes milliseconds for it where other threads keep the cores busy."""
    (a, b), (c, d) = matrix.tolist()
    return np.array([[d, -b], [-c, a]]) / (a * d - b * c)


def inverse_3x3(matrix: np.ndarray) -> np.ndarray:
    """Inverse of a (3, 3) matrix, likewise."""
    (a, b, c), (d, e, f), (g, h, i) = matrix.tolist()
    adjugate = np.array(
        [
            [e * i - f * h, c * h - b * i, b * f - c * e],
            [f * g - d * i, a * i - c * g, c * d - a * f],
            [d * h - e * g, b * g - a * h, a * e - b * d],
        ]
    )
    return adjugate / (a * adjugate[0, 0] + b * adjugate[1, 0] + c * adjugate[2, 0])


def lift(pose: np.ndarray) -> np.ndarray:
    """(4, 4) of a planar pose: z = 0, turned about z."""
    T = np.eye(4)
    T[:2, :2] = rotation(pose[2])
    T[:2, 3] = pose[:2]
    return T
