# SPDX-License-Identifier: BSD-3-Clause
"""Photometric comparison of points with another image: normal equations of the motion, and correlations.

Points are (N, 3) float32 in their own upright frame, metres, with (N,) float32 grey values. A camera is (16,) float64:
the first three rows of T_camera_upright, then fx, fy, cx, cy of the image, which is flat float32.
"""

import math
from typing import Tuple

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel, kernel_inlined
from ceiling_dso_ros.dso.geometry.projection import intrinsics_of, to_pixel
from ceiling_dso_ros.dso.images.interpolation import sample, sample_gradient

UNKNOWNS = 5  # forward, left, turn, gain, offset
BORDER_PX = 2.0
NEAREST_M = 0.1


@kernel_inlined
def _seen(camera: np.ndarray, x: float, y: float, z: float) -> Tuple[float, float, float, float, float]:
    """Position in the camera (X, Y, Z) and pixel (u, v) of an upright point; Z is 0 if it is too near."""
    X = camera[0] * x + camera[1] * y + camera[2] * z + camera[3]
    Y = camera[4] * x + camera[5] * y + camera[6] * z + camera[7]
    Z = camera[8] * x + camera[9] * y + camera[10] * z + camera[11]
    if Z < NEAREST_M:
        return X, Y, 0.0, -1.0, -1.0
    u, v = to_pixel(intrinsics_of(camera[12:]), X / Z, Y / Z)
    return X, Y, Z, u, v


@kernel
def grey_of(points: np.ndarray, image: np.ndarray, width: int, height: int, camera: np.ndarray) -> np.ndarray:
    """(N,) float32 grey values of points in an image of their own view; nan outside of it."""
    result = np.full(points.shape[0], np.nan, np.float32)
    for i in range(points.shape[0]):
        _, _, Z, u, v = _seen(camera, points[i, 0], points[i, 1], points[i, 2])
        if Z > 0.0 and BORDER_PX <= u < width - BORDER_PX - 1 and BORDER_PX <= v < height - BORDER_PX - 1:
            result[i] = sample(image, width, np.float32(u), np.float32(v))
    return result


@kernel
def add_normal_equations(
    points: np.ndarray, grey: np.ndarray, image: np.ndarray, width: int, height: int, camera: np.ndarray,
    motion: np.ndarray, forth: bool, affine: np.ndarray, huber: float, H: np.ndarray, b: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Add the residuals image(p) - (gain grey + offset) of all points in view to H (5, 5) and b (5,).

    Args:
        points, grey: of a view; nan grey values are left out.
        image, width, height, camera: of the other view.
        motion: (3,) T_a_b. The unknowns are right-multiplied on it.
        forth: the points are those of a and the image is that of b; else the other way round.
        affine: (2,) gain and offset.
        huber: residuals above it weigh less.
        H, b: changed.

    Returns:
        (3,) sum of the weighted squares, sum of the weights, points in view.
    """
    c, s = math.cos(motion[2]), math.sin(motion[2])
    J = np.zeros(UNKNOWNS)
    result = np.zeros(3)
    for i in range(points.shape[0]):
        if not math.isfinite(grey[i]):
            continue
        px, py, pz = float(points[i, 0]), float(points[i, 1]), float(points[i, 2])
        if forth:  # p_b = R' (p_a - t)
            dx, dy = px - motion[0], py - motion[1]
            qx, qy = c * dx + s * dy, -s * dx + c * dy
        else:  # p_a = R p_b + t
            qx, qy = c * px - s * py + motion[0], s * px + c * py + motion[1]
        X, Y, Z, u, v = _seen(camera, qx, qy, pz)
        if Z == 0.0 or not (BORDER_PX <= u < width - BORDER_PX - 1 and BORDER_PX <= v < height - BORDER_PX - 1):
            continue
        value, gx, gy = sample_gradient(image, width, np.float32(u), np.float32(v))
        r = value - (affine[0] * grey[i] + affine[1])
        weight = 1.0 if abs(r) <= huber else huber / abs(r)
        # by a shift of the upright point
        ux, uy = gx * camera[12] / Z, gy * camera[13] / Z
        uz = -(ux * X + uy * Y) / Z
        bx = ux * camera[0] + uy * camera[4] + uz * camera[8]
        by = ux * camera[1] + uy * camera[5] + uz * camera[9]
        if forth:
            J[0], J[1], J[2] = -bx, -by, bx * qy - by * qx
        else:
            J[0], J[1] = bx * c + by * s, -bx * s + by * c
            J[2] = -py * J[0] + px * J[1]
        J[3], J[4] = -grey[i], -1.0
        for m in range(UNKNOWNS):
            b[m] += weight * J[m] * r
            for n in range(UNKNOWNS):
                H[m, n] += weight * J[m] * J[n]
        result[0] += weight * r * r
        result[1] += weight
        result[2] += 1.0
    return result


@kernel
def correlations(
    points: np.ndarray, grey: np.ndarray, image: np.ndarray, width: int, height: int, camera: np.ndarray,
    motions: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """How well points of a agree with the image of b at several motions T_a_b, (M, 3).

    Returns:
        (M, 2) float64: correlation coefficient of the grey values, and number of points in view.
    """
    known = np.isfinite(grey)
    x, y, z = points[known, 0], points[known, 1], points[known, 2]
    expected = grey[known]
    result = np.zeros((motions.shape[0], 2))
    T = np.empty(12, np.float32)  # T_camera_a
    for k in range(motions.shape[0]):
        c, s = math.cos(motions[k, 2]), math.sin(motions[k, 2])
        for row in range(3):
            first, second = camera[4 * row], camera[4 * row + 1]
            T[4 * row], T[4 * row + 1] = c * first - s * second, s * first + c * second
            T[4 * row + 2] = camera[4 * row + 2]
            T[4 * row + 3] = camera[4 * row + 3] - T[4 * row] * motions[k, 0] - T[4 * row + 1] * motions[k, 1]
        n, sa, sb, saa, sbb, sab = _moments(x, y, z, expected, image, width, height, camera, T)
        result[k, 1] = n
        if n > 1:
            spread = (saa - sa * sa / n) * (sbb - sb * sb / n)
            if spread > 0.0:
                result[k, 0] = (sab - sa * sb / n) / math.sqrt(spread)
    return result


@kernel
def _moments(
    x: np.ndarray, y: np.ndarray, z: np.ndarray, expected: np.ndarray, image: np.ndarray, width: int, height: int,
    camera: np.ndarray, T: np.ndarray,
) -> Tuple[int, float, float, float, float, float]:  # fmt: skip
    """Number of points in view, and sums of expected, found, and their squares and products.

    A loop of its own, in single precision and without stores: it vectorises. It is most of what searching costs.
    """
    fx, fy, cx, cy = np.float32(camera[12]), np.float32(camera[13]), np.float32(camera[14]), np.float32(camera[15])
    low, right, bottom = np.float32(BORDER_PX), np.float32(width - BORDER_PX - 1), np.float32(height - BORDER_PX - 1)
    nearest = np.float32(NEAREST_M)
    n = 0
    sa = sb = saa = sbb = sab = np.float32(0.0)
    for i in range(x.shape[0]):
        Z = T[8] * x[i] + T[9] * y[i] + T[10] * z[i] + T[11]
        u = fx * (T[0] * x[i] + T[1] * y[i] + T[2] * z[i] + T[3]) / Z + cx
        v = fy * (T[4] * x[i] + T[5] * y[i] + T[6] * z[i] + T[7]) / Z + cy
        if not (nearest <= Z and low <= u < right and low <= v < bottom):
            continue
        value = sample(image, width, u, v)
        n += 1
        sa += expected[i]
        sb += value
        saa += expected[i] * expected[i]
        sbb += value * value
        sab += expected[i] * value
    return n, float(sa), float(sb), float(saa), float(sbb), float(sab)
