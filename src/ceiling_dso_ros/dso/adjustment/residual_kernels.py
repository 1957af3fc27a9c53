# SPDX-License-Identifier: BSD-3-Clause
"""Kernels that linearise the photometric residuals of one host-target pair, equations (4) to (8).

Everything is a struct of arrays over the points of the host, and every loop runs over points, so that it vectorises.
The Jacobian of a residual splits into the image gradient and brightness at the current estimate (per pixel) and the
geometry at the evaluation point (once per residual, first-estimate Jacobians). So the eight pixels reduce to the sums
of `PixelSums`, from which the normal equations of the residual follow.
"""

from typing import NamedTuple, Tuple

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel, kernel_noalias
from ceiling_dso_ros.dso.compute.struct_of_arrays import struct_of_arrays
from ceiling_dso_ros.dso.geometry.projection import in_view, intrinsics_of, projection_jacobian, warp_of, warp_point
from ceiling_dso_ros.dso.images.interpolation import sample_gradient
from ceiling_dso_ros.dso.images.pattern import GRADIENT_WEIGHT, HUBER, PATTERN_SIZE, PATTERN_X, PATTERN_Y

GEOMETRY = 10  # columns of the geometric Jacobian: fx fy cx cy, translation, rotation
COLUMNS = 13  # and gain, offset, residual
MIN_GRADIENT = np.float32(2.0)  # sum of w^2 |grad I|^2 that a residual needs
ZERO, ONE, TWO, HALF = np.float32(0), np.float32(1), np.float32(2), np.float32(0.5)


@struct_of_arrays
class PixelSums(NamedTuple):
    """Sums over the pattern of one residual per entry, float32, weighted with w^2 and Huber's weight.

    With g the image gradient in the target, r the residual and d = I_host - b_host:
    gxx, gxy, gyy: g g^T; dx, dy: d g; ox, oy: g; rx, ry: r g; dd, do, oo, dr, or_: products of (d, 1, r);
    energy: Huber energy; gradient: w^2 |g|^2; in_bounds: 1 while all pixels were in the image.
    """

    gxx: np.ndarray
    gxy: np.ndarray
    gyy: np.ndarray
    dx: np.ndarray
    dy: np.ndarray
    ox: np.ndarray
    oy: np.ndarray
    rx: np.ndarray
    ry: np.ndarray
    dd: np.ndarray
    do: np.ndarray
    oo: np.ndarray
    dr: np.ndarray
    or_: np.ndarray
    energy: np.ndarray
    gradient: np.ndarray
    in_bounds: np.ndarray


@struct_of_arrays
class LivePoints(NamedTuple):
    """The points of a host that have a live residual in one target, stored contiguously.

    Attributes:
        index: (capacity,) int64 which of the host's points they are.
        u, v, idepth: (capacity,) float32; grey, weight: (8, capacity) float32.
    """

    index: np.ndarray
    u: np.ndarray
    v: np.ndarray
    idepth: np.ndarray
    grey: np.ndarray
    weight: np.ndarray

    @classmethod
    def of_capacity(cls, capacity: int) -> "LivePoints":
        """Scratch memory for hosts of up to `capacity` points."""
        rows, patterns = np.zeros((3, capacity), np.float32), np.zeros((2, PATTERN_SIZE, capacity), np.float32)
        return cls(np.zeros(capacity, np.int64), *rows, *patterns)


def pixel_sums(capacity: int) -> PixelSums:
    """Scratch memory for hosts of up to `capacity` points."""
    return PixelSums(*(np.zeros(capacity, np.float32) for _ in PixelSums._fields))


@kernel_noalias
def add_pixel(
    image: np.ndarray, width: int, height: int, KRKi: np.ndarray, Kt: np.ndarray, gain: np.float32, offset: np.float32,
    host_offset: np.float32, pattern_x: np.float32, pattern_y: np.float32,
    u: np.ndarray, v: np.ndarray, idepth: np.ndarray, grey: np.ndarray, weight_host: np.ndarray, sums: PixelSums,
) -> None:  # fmt: skip
    """Add one pixel of the pattern of every point to the sums."""
    warp = warp_of(KRKi, Kt)
    for i in range(u.size):
        x, y, z, _ = warp_point(warp, u[i] + pattern_x, v[i] + pattern_y, idepth[i])
        inside = in_view(x, y, z, width, height)
        x, y = (x if inside else TWO), (y if inside else TWO)
        value, gx, gy = sample_gradient(image, width, x, y)
        residual = value - gain * grey[i] - offset
        gradient2 = gx * gx + gy * gy
        weight = HALF * (weight_host[i] + np.sqrt(GRADIENT_WEIGHT / (GRADIENT_WEIGHT + gradient2)))
        weight2 = weight * weight
        huber = HUBER / max(abs(residual), HUBER)
        w = weight2 * huber
        d = grey[i] - host_offset
        wgx, wgy, wd, wr = w * gx, w * gy, w * d, w * residual
        sums.gxx[i] += wgx * gx
        sums.gxy[i] += wgx * gy
        sums.gyy[i] += wgy * gy
        sums.dx[i] += wd * gx
        sums.dy[i] += wd * gy
        sums.ox[i] += wgx
        sums.oy[i] += wgy
        sums.rx[i] += wr * gx
        sums.ry[i] += wr * gy
        sums.dd[i] += wd * d
        sums.do[i] += wd
        sums.oo[i] += w
        sums.dr[i] += wd * residual
        sums.or_[i] += wr
        sums.energy[i] += wr * residual * (TWO - huber)
        sums.gradient[i] += weight2 * gradient2
        sums.in_bounds[i] = sums.in_bounds[i] if inside else ZERO


@kernel_noalias
def take(source: np.ndarray, index: np.ndarray, out: np.ndarray) -> None:
    """Set out[k] to source[index[k]]."""
    for k in range(out.size):
        out[k] = source[index[k]]


@kernel
def gather_live(
    live: np.ndarray, u: np.ndarray, v: np.ndarray, idepth: np.ndarray, grey: np.ndarray, weight: np.ndarray,
    first: int, points: LivePoints,
) -> int:  # fmt: skip
    """Gather a host's points, from `first` on, whose entry in live is not zero; returns their number."""
    count = 0
    for i in range(live.size):  # without a branch, because a branch could not be predicted
        points.index[count] = i
        count += np.int64(live[i] != 0)
    last = first + live.size
    index = points.index[:count]
    take(u[first:last], index, points.u[:count])
    take(v[first:last], index, points.v[:count])
    take(idepth[first:last], index, points.idepth[:count])
    for p in range(PATTERN_SIZE):
        take(grey[p, first:last], index, points.grey[p, :count])
        take(weight[p, first:last], index, points.weight[p, :count])
    return count


@kernel
def sum_pattern(
    image: np.ndarray, width: int, height: int, KRKi: np.ndarray, Kt: np.ndarray, gain: np.float32, offset: np.float32,
    host_offset: np.float32, points: LivePoints, count: int, sums: PixelSums,
) -> None:  # fmt: skip
    """Fill the sums of the first `count` points."""
    for array in sums:
        array[:count] = ZERO
    sums.in_bounds[:count] = ONE
    for p in range(PATTERN_SIZE):
        add_pixel(
            image, width, height, KRKi, Kt, gain, offset, host_offset, PATTERN_X[p], PATTERN_Y[p], points.u[:count],
            points.v[:count], points.idepth[:count], points.grey[p, :count], points.weight[p, :count], sums,
        )  # fmt: skip


@kernel_noalias
def fill_jacobian(
    u: np.ndarray, v: np.ndarray, idepth: np.ndarray, intrinsics: np.ndarray, R: np.ndarray, t: np.ndarray,
    rows_x: Tuple, rows_y: Tuple,
) -> None:  # fmt: skip
    """Store `projection_jacobian` of every point: rows_x[c][i], rows_y[c][i] with c = 0..9 geometry, 10 idepth."""
    camera, motion = intrinsics_of(intrinsics), warp_of(R, t)
    for i in range(u.size):
        j = projection_jacobian(camera, motion, u[i], v[i], idepth[i])
        rows_x[0][i], rows_x[1][i], rows_x[2][i], rows_x[3][i] = j[0], j[1], j[2], j[3]
        rows_x[4][i], rows_x[5][i], rows_x[6][i], rows_x[7][i] = j[4], j[5], j[6], j[7]
        rows_x[8][i], rows_x[9][i], rows_x[10][i] = j[8], j[9], j[10]
        rows_y[0][i], rows_y[1][i], rows_y[2][i], rows_y[3][i] = j[11], j[12], j[13], j[14]
        rows_y[4][i], rows_y[5][i], rows_y[6][i], rows_y[7][i] = j[15], j[16], j[17], j[18]
        rows_y[8][i], rows_y[9][i], rows_y[10][i] = j[19], j[20], j[21]


@kernel_noalias
def combine(a: np.ndarray, x: np.ndarray, b: np.ndarray, y: np.ndarray, out: np.ndarray) -> None:
    """Set out to a x + b y, entry by entry."""
    for i in range(out.size):
        out[i] = a[i] * x[i] + b[i] * y[i]


@kernel_noalias
def add_combination(a: np.ndarray, x: np.ndarray, b: np.ndarray, y: np.ndarray, out: np.ndarray) -> None:
    """Add a x + b y to out, entry by entry."""
    for i in range(out.size):
        out[i] += a[i] * x[i] + b[i] * y[i]


@kernel
def sum5(
    a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray, e: np.ndarray
) -> Tuple[np.float32, np.float32, np.float32, np.float32, np.float32]:
    """Five sums in one loop, which unlike numpy's vectorises."""
    sa = sb = sc = sd = se = ZERO
    for i in range(a.size):
        sa += a[i]
        sb += b[i]
        sc += c[i]
        sd += d[i]
        se += e[i]
    return sa, sb, sc, sd, se


@kernel
def dot4(
    x: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray
) -> Tuple[np.float32, np.float32, np.float32, np.float32]:
    """Four dot products with x in one loop, which keeps four accumulators in registers."""
    sa = sb = sc = sd = ZERO
    for i in range(x.size):
        sa += x[i] * a[i]
        sb += x[i] * b[i]
        sc += x[i] * c[i]
        sd += x[i] * d[i]
    return sa, sb, sc, sd


@kernel
def add_dots(rows: np.ndarray, others: np.ndarray, n: int, count: int, total: np.ndarray) -> None:
    """Add rows[i, :n] . others[j, :n] to total[i, j] for i < count and all j >= i; rows past the last are repeats."""
    last = others.shape[0] - 1
    for i in range(count):
        x = rows[i, :n]
        for j in range(i, last + 1, 4):
            j1, j2, j3 = min(j + 1, last), min(j + 2, last), min(j + 3, last)
            s0, s1, s2, s3 = dot4(x, others[j, :n], others[j1, :n], others[j2, :n], others[j3, :n])
            total[i, j] += s0
            if j + 1 <= last:
                total[i, j + 1] += s1
            if j + 2 <= last:
                total[i, j + 2] += s2
            if j + 3 <= last:
                total[i, j + 3] += s3
