# SPDX-License-Identifier: BSD-3-Clause
"""The projection of a point into another image, equation (5): the only place that knows the camera's model.

A host's pixel p with the inverse depth d, measured along the host's optical axis, is seen in a target at

    p' = Pi(R Pi^-1(p, d) + t),   Pi(X, Y, Z) = (fx X / Z + cx, fy Y / Z + cy),   Pi^-1(u, v, d) = K^-1 (u, v, 1) / d.

Multiplied by d, which the division by Z cancels, it is K R K^-1 (u, v, 1) + d K t, and on normalised coordinates
(x, y) = ((u - cx) / fx, (v - cy) / fy) it is R (x, y, 1) + d t. Both are a `Warp`: a matrix, a vector and a division.

Functions of scalars compute in the type of their arguments, float32 or float64, and are inlined where kernels call
them. A kernel that loops over points makes `Warp` and `Intrinsics` before its loop.
"""

from typing import NamedTuple, Tuple, TypeVar

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel, kernel_inlined

Numbers = TypeVar("Numbers", float, np.ndarray)

ZERO, ONE, TWO = np.float32(0), np.float32(1), np.float32(2)


class Intrinsics(NamedTuple):
    """Focal lengths and principal point in pixels."""

    fx: float
    fy: float
    cx: float
    cy: float


class Warp(NamedTuple):
    """M = ((xx, xy, x1), (yx, yy, y1), (zx, zy, z1)) and t = (tx, ty, tz): M (a, b, 1) + idepth t, then the division.

    From pixels to pixels M and t are K R K^-1 and K t, from normalised coordinates to such R and t.
    """

    xx: float
    xy: float
    x1: float
    yx: float
    yy: float
    y1: float
    zx: float
    zy: float
    z1: float
    tx: float
    ty: float
    tz: float


@kernel
def intrinsic_matrix(intrinsics: np.ndarray) -> np.ndarray:
    """K, (3, 3) float64, of (fx, fy, cx, cy)."""
    K = np.eye(3)
    K[0, 0], K[1, 1], K[0, 2], K[1, 2] = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    return K


@kernel
def intrinsic_inverse(intrinsics: np.ndarray) -> np.ndarray:
    """Inverse of K, (3, 3) float64, of (fx, fy, cx, cy)."""
    fx, fy, cx, cy = intrinsics
    K = np.eye(3)
    K[0, 0], K[1, 1], K[0, 2], K[1, 2] = 1.0 / fx, 1.0 / fy, -cx / fx, -cy / fy
    return K


def level_intrinsics(intrinsics: np.ndarray, level: int) -> np.ndarray:
    """(fx, fy, cx, cy) float64 on a pyramid level, with integer coordinates at pixel centres."""
    fx, fy, cx, cy = intrinsics
    scale = 1.0 / (1 << level)
    return np.array([fx * scale, fy * scale, (cx + 0.5) * scale - 0.5, (cy + 0.5) * scale - 0.5])


@kernel
def pixel_warp(K: np.ndarray, K_inverse: np.ndarray, T_target_host: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """K R K^-1, (3, 3), and K t, (3,), float64, of a motion (4, 4) between two images of the camera K."""
    R, t = np.ascontiguousarray(T_target_host[:3, :3]), np.ascontiguousarray(T_target_host[:3, 3])
    return K @ R @ K_inverse, K @ t


@kernel_inlined
def intrinsics_of(values: np.ndarray) -> Intrinsics:
    """The intrinsics in an array (fx, fy, cx, cy)."""
    return Intrinsics(values[0], values[1], values[2], values[3])


@kernel_inlined
def warp_of(M: np.ndarray, t: np.ndarray) -> Warp:
    """The warp of a matrix (3, 3) and a vector (3,)."""
    return Warp(
        M[0, 0], M[0, 1], M[0, 2], M[1, 0], M[1, 1], M[1, 2], M[2, 0], M[2, 1], M[2, 2], t[0], t[1], t[2]
    )  # fmt: skip


def normalized(intrinsics: Intrinsics, u: Numbers, v: Numbers) -> Tuple[Numbers, Numbers]:
    """Normalised coordinates (x, y) of pixels, for numpy; kernels have `unproject`, which is compiled from it."""
    return (u - intrinsics.cx) / intrinsics.fx, (v - intrinsics.cy) / intrinsics.fy


unproject = kernel_inlined(normalized)


def viewing_rays(intrinsics: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Viewing rays (x, y, 1) of pixels: one of inverse depth d shows the point ray / d.

    Args:
        intrinsics: (fx, fy, cx, cy), (4,) float64.
        u, v: pixels, of any one shape.

    Returns:
        (..., 3) float64.
    """
    x, y = normalized(Intrinsics(*intrinsics), u, v)
    return np.stack([x, y, np.ones(np.shape(x))], axis=-1)


def pixels(intrinsics: Intrinsics, x: Numbers, y: Numbers) -> Tuple[Numbers, Numbers]:
    """Pixels (u, v) of normalised coordinates, for numpy; kernels have `to_pixel`, which is compiled from it."""
    return intrinsics.fx * x + intrinsics.cx, intrinsics.fy * y + intrinsics.cy


to_pixel = kernel_inlined(pixels)


@kernel_inlined
def pixel_shift(intrinsics: Intrinsics, x: float, y: float, x_moved: float, y_moved: float) -> Tuple[float, float]:
    """Shift (du, dv) in pixels between two points in normalised coordinates."""
    return intrinsics.fx * (x_moved - x), intrinsics.fy * (y_moved - y)


@kernel_inlined
def warp_infinite(warp: Warp, a: float, b: float) -> Tuple[float, float, float]:
    """M (a, b, 1): where the point is seen at inverse depth 0, not yet divided."""
    return (
        warp.xx * a + warp.xy * b + warp.x1,
        warp.yx * a + warp.yy * b + warp.y1,
        warp.zx * a + warp.zy * b + warp.z1,
    )


@kernel_inlined
def warp_point(warp: Warp, a: float, b: float, idepth: float) -> Tuple[float, float, float, float]:
    """Where a point is seen in the target.

    Args:
        a, b: pixel or normalised coordinates in the host, as the warp has them.
        idepth: inverse depth in the host.

    Returns:
        (x, y) in the target, its depth there in units of that in the host, and one over that: times idepth it is the
        inverse depth in the target. (x, y) has a meaning only if the depth is positive.
    """
    infinite_x, infinite_y, infinite_z = warp_infinite(warp, a, b)
    z = infinite_z + warp.tz * idepth
    z_inverse = ONE / z
    return (infinite_x + warp.tx * idepth) * z_inverse, (infinite_y + warp.ty * idepth) * z_inverse, z, z_inverse


@kernel_inlined
def warp_offset(warp: Warp, a: float, b: float) -> Tuple[float, float]:
    """How an offset (a, b) between neighbouring points looks in the target, for a motion that changes depths little."""
    return warp.xx * a + warp.xy * b, warp.yx * a + warp.yy * b


@kernel_inlined
def in_view(u: float, v: float, z: float, width: int, height: int) -> bool:
    """Whether a point at pixel (u, v) and depth z is in front of the camera, and where the image can be sampled."""
    right, bottom = np.float32(width - 3), np.float32(height - 3)
    return (u > TWO) & (v > TWO) & (u < right) & (v < bottom) & (z > ZERO)


@kernel_inlined
def epipolar_direction(warp: Warp, x: float, y: float) -> Tuple[float, float]:
    """Which way the point seen at (x, y) moves as its idepth grows: z times the derivative of (x, y) by idepth."""
    return warp.tx - x * warp.tz, warp.ty - y * warp.tz


@kernel_inlined
def idepth_at(warp: Warp, a: float, b: float, x: float, y: float, along_x: bool) -> float:
    """Inverse depth in the host of the point (a, b) that is seen at (x, y): `warp_point` solved for x, or for y."""
    infinite_x, infinite_y, infinite_z = warp_infinite(warp, a, b)
    direction_x, direction_y = epipolar_direction(warp, x, y)
    if along_x:
        return (infinite_z * x - infinite_x) / direction_x
    return (infinite_z * y - infinite_y) / direction_y


@kernel_inlined
def pose_jacobian(intrinsics: Intrinsics, x: float, y: float, idepth: float) -> Tuple:
    """Derivatives of the pixel of a point by a left increment (translation, rotation) of its motion into the camera.

    Args:
        x, y, idepth: normalised coordinates and inverse depth in that camera.

    Returns:
        Six derivatives of u, and six of v.
    """
    fx, fy = intrinsics.fx, intrinsics.fy
    of_u = (fx * idepth, ZERO, -fx * idepth * x, -fx * x * y, fx * (ONE + x * x), -fx * y)
    of_v = (ZERO, fy * idepth, -fy * idepth * y, -fy * (ONE + y * y), fy * x * y, fy * x)
    return of_u, of_v


@kernel_inlined
def pose_gradient(x: float, y: float, idepth: float, gx: float, gy: float) -> Tuple:
    """Six derivatives of a grey value by the increment of `pose_jacobian`.

    Args:
        x, y, idepth: as there.
        gx, gy: derivatives of the grey value by x and y: the image gradient times (fx, fy).
    """
    return (
        idepth * gx, idepth * gy, -idepth * (x * gx + y * gy),
        -(x * y * gx + (ONE + y * y) * gy), (ONE + x * x) * gx + x * y * gy, x * gy - y * gx,
    )  # fmt: skip


@kernel_inlined
def projection_jacobian(intrinsics: Intrinsics, motion: Warp, u: float, v: float, idepth: float) -> Tuple:
    """Derivatives of the projected pixel of equation (5).

    Args:
        motion: R, t from host to target, on normalised coordinates.
        u, v, idepth: the host's pixel and inverse depth.

    Returns:
        Twenty-two numbers: d u' / d (fx, fy, cx, cy, translation, rotation, idepth), then the same for v'. Translation
        and rotation are a left increment on the motion.
    """
    fx, fy = intrinsics.fx, intrinsics.fy
    x_host, y_host = unproject(intrinsics, u, v)
    x, y, _, z_inverse = warp_point(motion, x_host, y_host, idepth)
    x_by_x_host, x_by_y_host = (motion.xx - motion.zx * x) * z_inverse, (motion.xy - motion.zy * x) * z_inverse
    y_by_x_host, y_by_y_host = (motion.yx - motion.zx * y) * z_inverse, (motion.yy - motion.zy * y) * z_inverse
    aspect = fx / fy
    pose_u, pose_v = pose_jacobian(intrinsics, x, y, idepth * z_inverse)
    direction_x, direction_y = epipolar_direction(motion, x, y)
    return (
        x - x_host * x_by_x_host, -aspect * y_host * x_by_y_host, ONE - x_by_x_host, -aspect * x_by_y_host,
        *pose_u, fx * direction_x * z_inverse,
        -x_host * y_by_x_host / aspect, y - y_host * y_by_y_host, -y_by_x_host / aspect, ONE - y_by_y_host,
        *pose_v, fy * direction_y * z_inverse,
    )  # fmt: skip
