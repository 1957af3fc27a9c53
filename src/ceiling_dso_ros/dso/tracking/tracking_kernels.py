# SPDX-License-Identifier: BSD-3-Clause
"""Kernels of the coarse-to-fine tracker: the photometric error of one pyramid level and its alignment."""

import math
from typing import Tuple

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel
from ceiling_dso_ros.dso.compute.linear_solver import solve_positive
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.geometry.projection import (
    in_view,
    intrinsics_of,
    pixel_shift,
    pose_gradient,
    to_pixel,
    unproject,
    warp_of,
    warp_point,
)
from ceiling_dso_ros.dso.images.interpolation import sample_gradient
from ceiling_dso_ros.dso.images.pattern import HUBER

ZERO, ONE, TWO = np.float32(0), np.float32(1), np.float32(2)


@kernel
def accumulate(
    u: np.ndarray, v: np.ndarray, idepth: np.ndarray, grey: np.ndarray,
    image: np.ndarray, width: int, height: int, intrinsics: np.ndarray, T_frame_reference: np.ndarray,
    gain: float, offset_reference: float, offset_frame: float, cutoff: float, system: np.ndarray,
) -> Tuple[float, int, int]:  # fmt: skip
    """Photometric error of points of the reference in an image, and its normal equations.

    The residual is I(p') - offset_frame - gain (grey - offset_reference); its derivative is taken for a left increment
    (translation, rotation) on T_frame_reference and for the frame's brightness parameters (a, b).

    The 45 sums stand in local scalars because LLVM keeps those in vector registers.

    Args:
        u, v, idepth, grey: (n,) float32 points of the reference on this level.
        image, width, height, intrinsics: the level of the new frame; intrinsics (fx, fy, cx, cy).
        T_frame_reference: (4, 4) motion that maps points of the reference camera to the frame's camera.
        gain, offset_reference, offset_frame: brightness transfer.
        cutoff: residuals above it (grey levels) count as saturated: they add energy and no information.
        system: (9, 9) float64 output, upper triangle of J^T W J with the residual as ninth column.

    Returns:
        Sum of Huber energies, number of points in view, number of saturated ones.
    """
    T = T_frame_reference.astype(np.float32)
    camera, motion = intrinsics_of(intrinsics.astype(np.float32)), warp_of(T[:3, :3], T[:3, 3])
    gain32, offset_ref32, offset32 = np.float32(gain), np.float32(offset_reference), np.float32(offset_frame)
    cutoff32 = np.float32(cutoff)
    energy_cap = TWO * HUBER * cutoff32 - HUBER * HUBER
    h00 = h01 = h02 = h03 = h04 = h05 = h06 = h07 = h08 = ZERO
    h11 = h12 = h13 = h14 = h15 = h16 = h17 = h18 = ZERO
    h22 = h23 = h24 = h25 = h26 = h27 = h28 = ZERO
    h33 = h34 = h35 = h36 = h37 = h38 = ZERO
    h44 = h45 = h46 = h47 = h48 = ZERO
    h55 = h56 = h57 = h58 = ZERO
    h66 = h67 = h68 = ZERO
    h77 = h78 = ZERO
    h88 = ZERO
    energy = ZERO
    seen, saturated = 0, 0
    for i in range(u.size):
        x_reference, y_reference = unproject(camera, u[i], v[i])
        x, y, z, z_inverse = warp_point(motion, x_reference, y_reference, idepth[i])
        column, row = to_pixel(camera, x, y)
        if not in_view(column, row, z, width, height):
            continue
        value, grad_x, grad_y = sample_gradient(image, width, column, row)
        reference_value = gain32 * (grey[i] - offset_ref32)
        residual = value - offset32 - reference_value
        magnitude = abs(residual)
        seen += 1
        if magnitude > cutoff32:
            energy += energy_cap
            saturated += 1
            continue
        weight = HUBER / max(magnitude, HUBER)
        energy += weight * residual * residual * (TWO - weight)
        j0, j1, j2, j3, j4, j5 = pose_gradient(x, y, idepth[i] * z_inverse, grad_x * camera.fx, grad_y * camera.fy)
        j6 = -reference_value
        j7 = -ONE
        w0 = weight * j0
        h00 += w0 * j0
        h01 += w0 * j1
        h02 += w0 * j2
        h03 += w0 * j3
        h04 += w0 * j4
        h05 += w0 * j5
        h06 += w0 * j6
        h07 += w0 * j7
        h08 += w0 * residual
        w1 = weight * j1
        h11 += w1 * j1
        h12 += w1 * j2
        h13 += w1 * j3
        h14 += w1 * j4
        h15 += w1 * j5
        h16 += w1 * j6
        h17 += w1 * j7
        h18 += w1 * residual
        w2 = weight * j2
        h22 += w2 * j2
        h23 += w2 * j3
        h24 += w2 * j4
        h25 += w2 * j5
        h26 += w2 * j6
        h27 += w2 * j7
        h28 += w2 * residual
        w3 = weight * j3
        h33 += w3 * j3
        h34 += w3 * j4
        h35 += w3 * j5
        h36 += w3 * j6
        h37 += w3 * j7
        h38 += w3 * residual
        w4 = weight * j4
        h44 += w4 * j4
        h45 += w4 * j5
        h46 += w4 * j6
        h47 += w4 * j7
        h48 += w4 * residual
        w5 = weight * j5
        h55 += w5 * j5
        h56 += w5 * j6
        h57 += w5 * j7
        h58 += w5 * residual
        w6 = weight * j6
        h66 += w6 * j6
        h67 += w6 * j7
        h68 += w6 * residual
        w7 = weight * j7
        h77 += w7 * j7
        h78 += w7 * residual
        w8 = weight * residual
        h88 += w8 * residual
    row = system[0]
    row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8] = h00, h01, h02, h03, h04, h05, h06, h07, h08
    row = system[1]
    row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8] = h11, h12, h13, h14, h15, h16, h17, h18
    row = system[2]
    row[2], row[3], row[4], row[5], row[6], row[7], row[8] = h22, h23, h24, h25, h26, h27, h28
    row = system[3]
    row[3], row[4], row[5], row[6], row[7], row[8] = h33, h34, h35, h36, h37, h38
    row = system[4]
    row[4], row[5], row[6], row[7], row[8] = h44, h45, h46, h47, h48
    row = system[5]
    row[5], row[6], row[7], row[8] = h55, h56, h57, h58
    row = system[6]
    row[6], row[7], row[8] = h66, h67, h68
    row = system[7]
    row[7], row[8] = h77, h78
    row = system[8]
    row[8] = h88
    return np.float64(energy), seen, saturated


@kernel
def step_size(step: np.ndarray) -> float:
    """Size of a step (translation, rotation, a, b) as an angle; brightness has a small weight."""
    a, b = 0.1 * step[6], 0.001 * step[7]
    return math.sqrt((step[:6] * step[:6]).sum() + a * a + b * b)


@kernel
def align(
    u: np.ndarray, v: np.ndarray, idepth: np.ndarray, grey: np.ndarray,
    image: np.ndarray, width: int, height: int, intrinsics: np.ndarray,
    T_frame_reference: np.ndarray, affine: np.ndarray, reference_affine: np.ndarray, exposure_ratio: float,
    prior: np.ndarray, cutoff: float, max_iterations: int, min_step: float,
    system: np.ndarray,
) -> Tuple[np.ndarray, np.ndarray, float, float]:  # fmt: skip
    """Align one level by Levenberg-Marquardt.

    Args:
        u, v, idepth, grey, image, width, height, intrinsics, T_frame_reference, cutoff: as in `accumulate`.
        affine, reference_affine: brightness parameters (a, b) of the frame and of the reference.
        exposure_ratio: exposure of the frame over that of the reference.
        prior: (2,) information per point on a and b, which keeps them near the reference's.
        max_iterations: at most so many steps.
        min_step: a step of a smaller `step_size` is the last one, and is not evaluated again.
        system: (9, 9) float64 output, normal equations at the result, or one small step before it.

    Returns:
        T_frame_reference, (a, b), RMSE in grey levels, share of saturated points. RMSE is inf with too few points.
    """
    T, ab = T_frame_reference.copy(), affine.copy()
    trial_system = np.empty((9, 9))
    gain = exposure_ratio * math.exp(ab[0] - reference_affine[0])
    energy, in_view, saturated = accumulate(
        u, v, idepth, grey, image, width, height, intrinsics, T, gain, reference_affine[1], ab[1], cutoff, system
    )
    if in_view < 20:
        return T, ab, np.inf, 1.0
    damping = 0.01
    H, b = np.empty((8, 8)), np.empty(8)
    for _ in range(max_iterations):
        for i in range(8):
            for j in range(i, 8):
                H[i, j] = H[j, i] = system[i, j]
            b[i] = -system[i, 8]
        for k in range(2):
            H[6 + k, 6 + k] += prior[k] * in_view
            b[6 + k] -= prior[k] * in_view * (ab[k] - reference_affine[k])
        for i in range(8):
            H[i, i] *= 1.0 + damping
        step = solve_positive(H, b)
        trial_T = se3.exp(step[:6]) @ T
        trial_ab = ab + step[6:]
        if step_size(step) < min_step:
            return trial_T, trial_ab, math.sqrt(energy / in_view), saturated / in_view
        gain = exposure_ratio * math.exp(trial_ab[0] - reference_affine[0])
        trial_energy, trial_in_view, trial_saturated = accumulate(
            u, v, idepth, grey, image, width, height, intrinsics, trial_T, gain, reference_affine[1], trial_ab[1],
            cutoff, trial_system,
        )  # fmt: skip
        if trial_in_view >= 20 and trial_energy / trial_in_view < energy / in_view:
            T, ab, energy, in_view, saturated = trial_T, trial_ab, trial_energy, trial_in_view, trial_saturated
            system[:] = trial_system
            damping *= 0.5
        else:
            damping = max(4.0 * damping, 0.01)
    return T, ab, math.sqrt(energy / in_view), saturated / in_view


@kernel
def pair_greys(
    u: np.ndarray, v: np.ndarray, idepth: np.ndarray, grey: np.ndarray,
    image: np.ndarray, width: int, height: int, intrinsics: np.ndarray, T_frame_reference: np.ndarray,
    greys: np.ndarray,
) -> int:  # fmt: skip
    """Grey values of the points that are in view, in the image and in the reference.

    Args:
        u, v, idepth, grey, image, width, height, intrinsics, T_frame_reference: as in `accumulate`.
        greys: (2, n) float32 output: of the image, of the reference.

    Returns:
        The number of points in view.
    """
    camera, motion = intrinsics_of(intrinsics), warp_of(T_frame_reference[:3, :3], T_frame_reference[:3, 3])
    count = 0
    for i in range(u.size):
        x_reference, y_reference = unproject(camera, u[i], v[i])
        x, y, z, _ = warp_point(motion, x_reference, y_reference, idepth[i])
        column, row = to_pixel(camera, x, y)
        if in_view(column, row, z, width, height):
            greys[0, count] = image[int(row + 0.5) * width + int(column + 0.5)]
            greys[1, count] = grey[i]
            count += 1
    return count


@kernel
def mean_squared_flow(
    u: np.ndarray, v: np.ndarray, idepth: np.ndarray, intrinsics: np.ndarray, T_frame_reference: np.ndarray
) -> Tuple[float, float]:
    """Mean squared shift of points in pixels^2, by the translation alone and by the whole motion."""
    camera, t = intrinsics_of(intrinsics), T_frame_reference[:3, 3]
    translation, motion = warp_of(np.eye(3), t), warp_of(T_frame_reference[:3, :3], t)
    by_translation, by_motion, count = 0.0, 0.0, 0
    for i in range(u.size):
        x, y = unproject(camera, u[i], v[i])
        x_translated, y_translated, z_translated, _ = warp_point(translation, x, y, idepth[i])
        x_moved, y_moved, z_moved, _ = warp_point(motion, x, y, idepth[i])
        if z_translated <= 0.0 or z_moved <= 0.0:
            continue
        shift_x, shift_y = pixel_shift(camera, x, y, x_translated, y_translated)
        motion_x, motion_y = pixel_shift(camera, x, y, x_moved, y_moved)
        by_translation += shift_x * shift_x + shift_y * shift_y
        by_motion += motion_x * motion_x + motion_y * motion_y
        count += 1
    return by_translation / max(count, 1), by_motion / max(count, 1)
