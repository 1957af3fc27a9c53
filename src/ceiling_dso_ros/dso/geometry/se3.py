# SPDX-License-Identifier: BSD-3-Clause
"""Rigid motions as (4, 4) float64 matrices with tangent vectors (translation, rotation), usable from kernels.

Increments multiply from the left: exp(xi) @ T, equation (6). Formulas: Sola, Deray, Atchuthan, "A micro Lie theory".
"""

import math

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel


@kernel
def hat(w: np.ndarray) -> np.ndarray:
    """Matrix (3, 3) of the cross product with w."""
    m = np.zeros((3, 3))
    m[0, 1], m[0, 2], m[1, 2] = -w[2], w[1], -w[0]
    m[1, 0], m[2, 0], m[2, 1] = w[2], -w[1], w[0]
    return m


@kernel
def exp(xi: np.ndarray) -> np.ndarray:
    """Motion (4, 4) of a tangent vector (6,)."""
    w = xi[3:6]
    angle2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    angle = math.sqrt(angle2)
    if angle < 1e-5:
        a, b, c = 1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0, 1.0 / 6.0 - angle2 / 120.0
    else:
        a = math.sin(angle) / angle
        b = (1.0 - math.cos(angle)) / angle2
        c = (1.0 - a) / angle2
    W = hat(w)
    WW = W @ W
    identity = np.eye(3)
    T = np.eye(4)
    T[:3, :3] = identity + a * W + b * WW
    V = identity + b * W + c * WW
    for i in range(3):
        T[i, 3] = V[i, 0] * xi[0] + V[i, 1] * xi[1] + V[i, 2] * xi[2]
    return T


@kernel
def log_so3(R: np.ndarray) -> np.ndarray:
    """Rotation vector (3,) of a rotation matrix, of length 0..pi."""
    vee = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine2 = math.sqrt(vee[0] * vee[0] + vee[1] * vee[1] + vee[2] * vee[2])
    cosine2 = R[0, 0] + R[1, 1] + R[2, 2] - 1.0
    angle = math.atan2(sine2, cosine2)
    if sine2 > 1e-9:
        return vee * (angle / sine2)
    if cosine2 > 0.0:
        return 0.5 * vee
    k = 0  # half a turn: the axis is the largest column of R + I
    for i in range(1, 3):
        if R[i, i] > R[k, k]:
            k = i
    axis = R[:, k].copy()
    axis[k] += 1.0
    return axis * (math.pi / math.sqrt(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2]))


@kernel
def log(T: np.ndarray) -> np.ndarray:
    """Tangent vector (6,) of a motion: exp(log(T)) = T."""
    w = log_so3(T[:3, :3])
    angle2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    angle = math.sqrt(angle2)
    if angle < 1e-5:
        c = 1.0 / 12.0 + angle2 / 720.0
    else:
        c = (1.0 - 0.5 * angle * math.cos(0.5 * angle) / math.sin(0.5 * angle)) / angle2
    W = hat(w)
    V_inverse = np.eye(3) - 0.5 * W + c * (W @ W)
    xi = np.empty(6)
    for i in range(3):
        xi[i] = V_inverse[i, 0] * T[0, 3] + V_inverse[i, 1] * T[1, 3] + V_inverse[i, 2] * T[2, 3]
        xi[3 + i] = w[i]
    return xi


@kernel
def inverse(T: np.ndarray) -> np.ndarray:
    """Inverse of a motion."""
    result = np.eye(4)
    for i in range(3):
        for j in range(3):
            result[i, j] = T[j, i]
            result[i, 3] -= T[j, i] * T[j, 3]
    return result


@kernel
def adjoint(T: np.ndarray) -> np.ndarray:
    """(6, 6) matrix with exp(adjoint(T) @ xi) = T @ exp(xi) @ inverse(T)."""
    result = np.zeros((6, 6))
    result[:3, :3] = T[:3, :3]
    result[3:, 3:] = T[:3, :3]
    result[:3, 3:] = hat(T[:3, 3]) @ np.ascontiguousarray(T[:3, :3])
    return result


def orthonormalized(T: np.ndarray) -> np.ndarray:
    """The rigid motion nearest to T: removes the rounding errors of long products."""
    U, _, Vt = np.linalg.svd(T[:3, :3])
    result = np.eye(4)
    result[:3, :3] = U @ Vt
    result[:3, 3] = T[:3, 3]
    return result
