# SPDX-License-Identifier: BSD-3-Clause
"""Linearisation of the window: residual states and normal equations per host, put together."""

from typing import NamedTuple

import numpy as np

from ceiling_dso_ros.dso.adjustment.reduction_kernels import add_absolute, idepth_steps, subtract_schur
from ceiling_dso_ros.dso.adjustment.residual_kernels import (
    COLUMNS,
    GEOMETRY,
    MIN_GRADIENT,
    LivePoints,
    PixelSums,
    add_combination,
    add_dots,
    combine,
    fill_jacobian,
    gather_live,
    pixel_sums,
    sum5,
    sum_pattern,
    take,
)
from ceiling_dso_ros.dso.compute.jit import kernel
from ceiling_dso_ros.dso.compute.struct_of_arrays import struct_of_arrays
from ceiling_dso_ros.dso.window.keyframe_window import FRAME_PARAMETERS, INTRINSICS, KeyframeArrays, KeyframeWindow
from ceiling_dso_ros.dso.window.pair_geometry import PairGeometry, pair_geometry
from ceiling_dso_ros.dso.window.points import (
    INLIER,
    OUT_OF_BOUNDS,
    OUTLIER,
    RELATIVE_PARAMETERS,
    PointArrays,
    PointTable,
    ResidualArrays,
)


@struct_of_arrays
class Scratch(NamedTuple):
    """Scratch memory of one linearisation; float32.

    Attributes:
        live, live_sums: the points of a pair with live residuals, and the sums of these; one more entry stays zero.
        position: (capacity,) int64 where in live_sums the inlier of a host's point is, or at the entry that is zero.
        sums: per point of the host, zero where there is no inlier.
        jacobian_x, jacobian_y: (11, capacity) geometry and idepth columns.
        weighted_x, weighted_y: (13, capacity) the same times the weights, with gain, offset and residual.
        depth_rows, scaled_rows: (4 + 8 slots + 1, capacity) rows for the Schur complement.
    """

    live: LivePoints
    live_sums: PixelSums
    position: np.ndarray
    sums: PixelSums
    jacobian_x: np.ndarray
    jacobian_y: np.ndarray
    weighted_x: np.ndarray
    weighted_y: np.ndarray
    depth_rows: np.ndarray
    scaled_rows: np.ndarray


def scratch_memory(slots: int, capacity: int) -> Scratch:
    """Scratch for hosts of up to `capacity` points in a window of `slots` keyframes."""
    schur_rows = INTRINSICS + RELATIVE_PARAMETERS * slots + 1
    rows = (GEOMETRY + 1, GEOMETRY + 1, COLUMNS, COLUMNS, schur_rows, schur_rows)
    return Scratch(
        LivePoints.of_capacity(capacity), pixel_sums(capacity + 1), np.zeros(capacity, np.int64), pixel_sums(capacity),
        *(np.zeros((r, capacity), np.float32) for r in rows),
    )  # fmt: skip


@kernel
def classify(
    index: np.ndarray, live_sums: PixelSums, threshold: np.float32, state: np.ndarray, energy: np.ndarray,
    position: np.ndarray, nowhere: int,
) -> tuple:  # fmt: skip
    """Decide which live residuals of a pair are inliers.

    Args:
        index: (live residuals,) which point each belongs to.
        state, energy: of all points; those of the live residuals are updated.
        position: (points,) int64 output, where among the live residuals a point's inlier is; `nowhere` if it has none.

    Returns:
        Sum of energies, outliers counted with the threshold, and the number of live residuals in the image.
    """
    total, count = np.float32(0), 0
    position[:] = nowhere
    for k in range(index.size):  # without a branch, because a branch could not be predicted
        i, inside = index[k], live_sums.in_bounds[k] != 0
        good = inside and live_sums.energy[k] <= threshold and live_sums.gradient[k] >= MIN_GRADIENT
        state[i] = INLIER if good else (OUTLIER if inside else OUT_OF_BOUNDS)
        energy[i] = live_sums.energy[k] if inside else energy[i]
        position[i] = k if good else nowhere
        total += live_sums.energy[k] if good else (threshold if inside else np.float32(0))
        count += np.int64(inside)  # type: ignore[assignment]  # to numba an int
    return total, count


@kernel
def sum_pair(
    live: np.ndarray, first: int, points: PointArrays, image: np.ndarray, width: int, height: int, KRKi: np.ndarray,
    Kt: np.ndarray, gain: np.float32, offset: np.float32, host_offset: np.float32, threshold: np.float32,
    state: np.ndarray, energy: np.ndarray, scratch: Scratch,
) -> tuple:  # fmt: skip
    """Sums of the live residuals of one pair into scratch.live_sums; which are inliers into scratch.position.

    The arrays live, state and energy are of the host's points.

    Returns:
        As `classify`.
    """
    count = gather_live(live, points.u, points.v, points.idepth, points.grey, points.weight, first, scratch.live)
    sum_pattern(
        image, width, height, KRKi, Kt, gain, offset, host_offset, scratch.live, count, scratch.live_sums
    )  # fmt: skip
    return classify(
        scratch.live.index[:count], scratch.live_sums, threshold, state, energy, scratch.position[: live.size],
        scratch.position.size,
    )  # fmt: skip


@kernel
def add_pair(
    points: PointArrays, idepth_relative: np.ndarray, first: int, last: int, intrinsics: np.ndarray,
    R: np.ndarray, t: np.ndarray, scratch: Scratch, pair_system: np.ndarray,
) -> None:  # fmt: skip
    """Add the normal equations, (13, 13), of a pair's inliers, and their rows of the inverse depths."""
    n = last - first
    for array, live_array in zip(scratch.sums, scratch.live_sums):
        take(live_array, scratch.position[:n], array[:n])
    jx, jy, wx, wy, s = scratch.jacobian_x, scratch.jacobian_y, scratch.weighted_x, scratch.weighted_y, scratch.sums
    gxx, gxy, gyy = s.gxx[:n], s.gxy[:n], s.gyy[:n]
    rows_x = (jx[0], jx[1], jx[2], jx[3], jx[4], jx[5], jx[6], jx[7], jx[8], jx[9], jx[10])
    rows_y = (jy[0], jy[1], jy[2], jy[3], jy[4], jy[5], jy[6], jy[7], jy[8], jy[9], jy[10])
    fill_jacobian(
        points.u[first:last], points.v[first:last], points.idepth[first:last], intrinsics, R, t, rows_x, rows_y
    )
    for c in range(GEOMETRY):
        combine(gxx, jx[c, :n], gxy, jy[c, :n], wx[c, :n])
        combine(gxy, jx[c, :n], gyy, jy[c, :n], wy[c, :n])
    wx[GEOMETRY, :n], wx[GEOMETRY + 1, :n], wx[GEOMETRY + 2, :n] = s.dx[:n], s.ox[:n], s.rx[:n]
    wy[GEOMETRY, :n], wy[GEOMETRY + 1, :n], wy[GEOMETRY + 2, :n] = s.dy[:n], s.oy[:n], s.ry[:n]
    add_dots(jx, wx, n, GEOMETRY, pair_system)
    add_dots(jy, wy, n, GEOMETRY, pair_system)
    dd, do, dr, oo, or_ = sum5(s.dd[:n], s.do[:n], s.dr[:n], s.oo[:n], s.or_[:n])
    pair_system[10, 10] += dd
    pair_system[10, 11] += do
    pair_system[10, 12] += dr
    pair_system[11, 11] += oo
    pair_system[11, 12] += or_

    depth_x, depth_y = jx[GEOMETRY, :n], jy[GEOMETRY, :n]
    for c in range(INTRINSICS):
        add_combination(wx[c, :n], depth_x, wy[c, :n], depth_y, points.idepth_intrinsics[c, first:last])
    for c in range(RELATIVE_PARAMETERS):
        row = INTRINSICS + c
        combine(wx[row, :n], depth_x, wy[row, :n], depth_y, idepth_relative[c, first:last])
    add_combination(wx[12, :n], depth_x, wy[12, :n], depth_y, points.idepth_gradient[first:last])
    combine(gxx, depth_x, gxy, depth_y, wx[0, :n])
    combine(gxy, depth_x, gyy, depth_y, wy[0, :n])
    add_combination(wx[0, :n], depth_x, wy[0, :n], depth_y, points.idepth_hessian[first:last])


@kernel
def assess_pair(
    host: int, target: int, first: int, last: int, points: PointArrays, residuals: ResidualArrays,
    keyframes: KeyframeArrays, pairs: PairGeometry, images: np.ndarray, width: int, height: int, scratch: Scratch,
) -> tuple:  # fmt: skip
    """Do `sum_pair` for a pair of the window; arguments as in `linearize_host`."""
    return sum_pair(
        residuals.live[target, first:last], first, points, images[keyframes.image_slot[target]], width, height,
        pairs.KRKi[host, target], pairs.Kt[host, target], pairs.gain[host, target], pairs.offset[host, target],
        np.float32(keyframes.affine_eval[host, 1]),
        max(keyframes.energy_threshold[host], keyframes.energy_threshold[target]),
        residuals.state[target, first:last], residuals.energy[target, first:last], scratch,
    )  # fmt: skip


@kernel
def linearize_host(
    host: int, n: int, first: int, last: int, points: PointArrays, residuals: ResidualArrays, keyframes: KeyframeArrays,
    pairs: PairGeometry, images: np.ndarray, width: int, height: int, intrinsics: np.ndarray, scratch: Scratch,
    system: np.ndarray,
) -> tuple:  # fmt: skip
    """Linearise all residuals of one host's points.

    Args:
        host, n: slot of the host, number of keyframes.
        first, last: range of its points.
        points, residuals: states, energies and the inverse depths' rows are updated.
        images: pool of pyramids, level 0 first in each row.
        system: (4 + 8 n + 1, same) float64 output, symmetric normal equations in (intrinsics, relative parameters into
            every target, residual), without the Schur complement.

    Returns:
        Sum of energies and number of residuals.
    """
    system[:] = 0.0
    points.idepth_hessian[first:last] = 0
    points.idepth_gradient[first:last] = 0
    points.idepth_intrinsics[:, first:last] = 0
    energy, count = 0.0, 0
    end = INTRINSICS + RELATIVE_PARAMETERS * n
    pair_system = np.empty((COLUMNS, COLUMNS))
    for target in range(n):
        if target == host:
            continue
        pair_energy, pair_count = assess_pair(
            host, target, first, last, points, residuals, keyframes, pairs, images, width, height, scratch
        )
        energy += pair_energy
        count += pair_count
        pair_system[:] = 0.0
        add_pair(
            points, residuals.idepth_relative[target], first, last, intrinsics,
            pairs.R_eval[host, target], pairs.t_eval[host, target], scratch, pair_system,
        )  # fmt: skip
        o = INTRINSICS + RELATIVE_PARAMETERS * target
        for i in range(COLUMNS):
            row = i if i < INTRINSICS else (end if i == COLUMNS - 1 else o + i - INTRINSICS)
            for j in range(i, COLUMNS):
                column = j if j < INTRINSICS else (end if j == COLUMNS - 1 else o + j - INTRINSICS)
                system[row, column] += pair_system[i, j]
                if row != column:
                    system[column, row] += pair_system[i, j]
    return energy, count


@kernel
def linearize_window(
    n: int, ranges: np.ndarray, points: PointArrays, residuals: ResidualArrays, keyframes: KeyframeArrays,
    pairs: PairGeometry, images: np.ndarray, width: int, height: int, intrinsics: np.ndarray,
    scratch: Scratch, H: np.ndarray, b: np.ndarray,
) -> tuple:  # fmt: skip
    """Normal equations of all residuals without the inverse depths into H and b = J^T W r; returns energy, count."""
    H[:] = 0.0
    b[:] = 0.0
    end = INTRINSICS + RELATIVE_PARAMETERS * n
    system = np.empty((end + 1, end + 1))
    energy, count = 0.0, 0
    for host in range(n):
        first, last = ranges[host], ranges[host + 1]
        if first == last:
            continue
        host_energy, host_count = linearize_host(
            host, n, first, last, points, residuals, keyframes, pairs, images, width, height, intrinsics, scratch,
            system,
        )  # fmt: skip
        energy += host_energy
        count += host_count
        subtract_schur(
            host, n, first, last, points, residuals.idepth_relative, scratch.depth_rows, scratch.scaled_rows, system
        )
        add_absolute(host, n, pairs, system, H, b)
    return energy, count


@kernel
def assess_window(
    n: int, ranges: np.ndarray, points: PointArrays, residuals: ResidualArrays, keyframes: KeyframeArrays,
    pairs: PairGeometry, images: np.ndarray, width: int, height: int, scratch: Scratch,
) -> tuple:  # fmt: skip
    """States and energies of all residuals, without a linearisation; returns energy, count."""
    energy, count = 0.0, 0
    for host in range(n):
        for target in range(n):
            if target == host:
                continue
            pair_energy, pair_count = assess_pair(
                host, target, ranges[host], ranges[host + 1], points, residuals, keyframes, pairs, images, width,
                height, scratch,
            )  # fmt: skip
            energy += pair_energy
            count += pair_count
    return energy, count


class Linearization:
    """The photometric energy of points, quadratic around the current estimate of the window.

    Attributes:
        H, b: (4 + 8 n,) float64 normal equations with the inverse depths eliminated, H x = -b.
        energy, count: sum of energies and number of residuals.
    """

    def __init__(self, slots: int, capacity: int) -> None:
        self._scratch = scratch_memory(slots, capacity)
        self.H, self.b = np.zeros((0, 0)), np.zeros(0)
        self.energy, self.count = 0.0, 0

    def update(self, window: KeyframeWindow, points: PointTable) -> None:
        """Linearise the live residuals of points at the window's estimate."""
        n = window.count
        self._ranges = points.host_ranges(n)
        self._pairs = pair_geometry(window.keyframes, n, window.intrinsics)
        size = INTRINSICS + FRAME_PARAMETERS * n
        self.H, self.b = np.empty((size, size)), np.empty(size)
        self.energy, self.count = linearize_window(
            n, self._ranges, points.arrays, points.residuals, window.keyframes, self._pairs,
            window.pool.buffers, window.width, window.height, window.intrinsics.astype(np.float32),
            self._scratch, self.H, self.b,
        )  # fmt: skip

    def assess(self, window: KeyframeWindow, points: PointTable) -> None:
        """Update the energy, and states and energies of the residuals; H, b and the points' Hessians do not change."""
        n = window.count
        self.energy, self.count = assess_window(
            n, points.host_ranges(n), points.arrays, points.residuals, window.keyframes,
            pair_geometry(window.keyframes, n, window.intrinsics), window.pool.buffers, window.width, window.height,
            self._scratch,
        )  # fmt: skip

    def idepth_steps(self, window: KeyframeWindow, step: np.ndarray) -> np.ndarray:
        """Steps of the inverse depths, (points,) float32, that belong to a step of the other parameters."""
        return idepth_steps(
            window.count, self._ranges, window.points.arrays, window.points.residuals, self._pairs, step
        )
