# SPDX-License-Identifier: BSD-3-Clause
"""Kernels that reduce the normal equations of a host: they eliminate the inverse depths and change from relative to
absolute parameters.

The relative parameters of a host-target pair are the motion (left increment), the gain and the offset. They depend on
the parameters of the two keyframes: the relative motion moves by d_target - Ad(T_target_host) d_host; the columns for
gain and offset were I_host - b_host and 1, so d r / d (a, b) is -gain and -1 times those for the target, and gain times
both for the host.
"""

import numpy as np

from ceiling_dso_ros.dso.adjustment.residual_kernels import add_dots
from ceiling_dso_ros.dso.compute.jit import kernel, kernel_noalias
from ceiling_dso_ros.dso.window.keyframe_window import FRAME_PARAMETERS, INTRINSICS
from ceiling_dso_ros.dso.window.pair_geometry import PairGeometry
from ceiling_dso_ros.dso.window.points import RELATIVE_PARAMETERS, PointArrays, ResidualArrays

MIN_IDEPTH_HESSIAN = np.float32(1e-6)


@kernel
def subtract_schur(
    host: int, n: int, first: int, last: int, points: PointArrays, idepth_relative: np.ndarray,
    rows: np.ndarray, scaled: np.ndarray, system: np.ndarray,
) -> None:  # fmt: skip
    """Eliminate the inverse depths of a host's points from its system.

    Args:
        rows, scaled: (4 + 8 n + 1, capacity) float32 scratch memory.
        system: as in `linearize_host`.
    """
    m = last - first
    targets = np.array([target for target in range(n) if target != host])
    used = INTRINSICS + RELATIVE_PARAMETERS * targets.size + 1
    rows[:INTRINSICS, :m] = points.idepth_intrinsics[:, first:last]
    for k, target in enumerate(targets):
        o = INTRINSICS + RELATIVE_PARAMETERS * k
        rows[o : o + RELATIVE_PARAMETERS, :m] = idepth_relative[target, :, first:last]
    rows[used - 1, :m] = points.idepth_gradient[first:last]
    inverse = np.empty(m, np.float32)
    for i in range(m):
        hessian = points.idepth_hessian[first + i]
        inverse[i] = np.float32(1) / hessian if hessian > MIN_IDEPTH_HESSIAN else np.float32(0)
    for row in range(used):
        for i in range(m):
            scaled[row, i] = rows[row, i] * inverse[i]
    product = np.zeros((used, used))
    add_dots(rows, scaled[:used], m, used, product)
    position = np.empty(used, np.int64)
    position[:INTRINSICS] = np.arange(INTRINSICS)
    position[used - 1] = INTRINSICS + RELATIVE_PARAMETERS * n
    for k, target in enumerate(targets):
        for c in range(RELATIVE_PARAMETERS):
            position[INTRINSICS + RELATIVE_PARAMETERS * k + c] = INTRINSICS + RELATIVE_PARAMETERS * target + c
    for i in range(used):
        for j in range(i, used):
            system[position[i], position[j]] -= product[i, j]
            if i != j:
                system[position[j], position[i]] -= product[i, j]


@kernel_noalias
def add_scaled(factor: float, x: np.ndarray, out: np.ndarray) -> None:
    """Add factor x to out, entry by entry."""
    for i in range(out.size):
        out[i] += factor * x[i]


@kernel
def to_absolute(host: int, n: int, pairs: PairGeometry, rows: np.ndarray) -> np.ndarray:
    """B^T rows, where B is the derivative of (intrinsics, relative parameters of a host) by (intrinsics, keyframes).

    Args:
        rows: (4 + 8 n, m) float64.

    Returns:
        (4 + 8 n, m) float64.
    """
    result = np.zeros(rows.shape)
    result[:INTRINSICS] = rows[:INTRINSICS]
    h = INTRINSICS + FRAME_PARAMETERS * host
    for target in range(n):
        if target == host:
            continue
        t = INTRINSICS + FRAME_PARAMETERS * target
        gain = np.float64(pairs.gain_eval[host, target])
        for k in range(6):
            result[t + k] = rows[t + k]
            for c in range(6):
                add_scaled(-pairs.adjoint_eval[host, target, k, c], rows[t + k], result[h + c])
        add_scaled(-gain, rows[t + 6], result[t + 6])
        add_scaled(-1.0, rows[t + 7], result[t + 7])
        add_scaled(gain, rows[t + 6], result[h + 6])
        add_scaled(gain, rows[t + 7], result[h + 7])
    return result


@kernel
def add_absolute(host: int, n: int, pairs: PairGeometry, system: np.ndarray, H: np.ndarray, b: np.ndarray) -> None:
    """Add a host's system in relative parameters, (4 + 8 n + 1, same) float64 symmetric, to H and b."""
    end = INTRINSICS + RELATIVE_PARAMETERS * n
    half = to_absolute(host, n, pairs, system[:end])
    b += half[:, end]
    H += to_absolute(host, n, pairs, np.ascontiguousarray(half[:, :end].T))


@kernel
def relative_step(host: int, n: int, pairs: PairGeometry, step: np.ndarray) -> np.ndarray:
    """Step of (intrinsics, relative parameters of a host), (4 + 8 n,), that belongs to one of all keyframes."""
    result = np.zeros(step.size)
    result[:INTRINSICS] = step[:INTRINSICS]
    h = INTRINSICS + FRAME_PARAMETERS * host
    for target in range(n):
        if target == host:
            continue
        t = INTRINSICS + FRAME_PARAMETERS * target
        gain = np.float64(pairs.gain_eval[host, target])
        for k in range(6):
            total = step[t + k]
            for c in range(6):
                total -= pairs.adjoint_eval[host, target, k, c] * step[h + c]
            result[t + k] = total
        result[t + 6] = gain * (step[h + 6] - step[t + 6])
        result[t + 7] = gain * step[h + 7] - step[t + 7]
    return result


@kernel
def idepth_steps(
    n: int, ranges: np.ndarray, points: PointArrays, residuals: ResidualArrays, pairs: PairGeometry, step: np.ndarray
) -> np.ndarray:
    """Back substitution: the step of every inverse depth, (count,) float32, for a step of (intrinsics, keyframes)."""
    result = np.zeros(ranges[n], np.float32)
    for host in range(n):
        first, last = ranges[host], ranges[host + 1]
        relative = relative_step(host, n, pairs, step).astype(np.float32)
        total = points.idepth_gradient[first:last].copy()
        for c in range(INTRINSICS):
            total += points.idepth_intrinsics[c, first:last] * relative[c]
        for target in range(n):
            if target != host:
                for c in range(RELATIVE_PARAMETERS):
                    change = relative[INTRINSICS + RELATIVE_PARAMETERS * target + c]
                    total += residuals.idepth_relative[target, c, first:last] * change
        for i in range(last - first):
            hessian = points.idepth_hessian[first + i]
            result[first + i] = -total[i] / hessian if hessian > MIN_IDEPTH_HESSIAN else np.float32(0)
    return result
