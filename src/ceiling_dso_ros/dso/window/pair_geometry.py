# SPDX-License-Identifier: BSD-3-Clause
"""Relative geometry and brightness of every host-target pair, at the estimate and at the evaluation point."""

from typing import NamedTuple

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel
from ceiling_dso_ros.dso.compute.struct_of_arrays import struct_of_arrays
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.geometry.projection import (
    intrinsic_inverse,
    intrinsic_matrix,
    pixel_warp,
    warp_of,
    warp_point,
)
from ceiling_dso_ros.dso.window.keyframe_window import KeyframeArrays


@struct_of_arrays
class PairGeometry(NamedTuple):
    """Arrays indexed by (host, target); float32 but for the adjoints.

    Attributes:
        KRKi: (n, n, 3, 3), from host pixels to the target at inverse depth 0.
        Kt: (n, n, 3), change of that with inverse depth.
        gain, offset: (n, n), I_target = gain I_host + offset, equation (4).
        R_eval: (n, n, 3, 3), t_eval: (n, n, 3), motion from host to target camera at the evaluation point.
        gain_eval: (n, n) gain at the evaluation point.
        adjoint_eval: (n, n, 6, 6) float64 adjoint of the motion at the evaluation point.
    """

    KRKi: np.ndarray
    Kt: np.ndarray
    gain: np.ndarray
    offset: np.ndarray
    R_eval: np.ndarray
    t_eval: np.ndarray
    gain_eval: np.ndarray
    adjoint_eval: np.ndarray


@kernel
def fill_pairs(keyframes: KeyframeArrays, n: int, intrinsics: np.ndarray, pairs: PairGeometry) -> None:
    """Fill in the geometry of the pairs of the first n keyframes."""
    K, K_inverse = intrinsic_matrix(intrinsics), intrinsic_inverse(intrinsics)
    for host in range(n):
        T_world_host = se3.inverse(keyframes.T_camera_world[host])
        T_world_host_eval = se3.inverse(keyframes.T_camera_world_eval[host])
        for target in range(n):
            if target == host:
                continue
            T = keyframes.T_camera_world[target] @ T_world_host
            T_eval = keyframes.T_camera_world_eval[target] @ T_world_host_eval
            KRKi, Kt = pixel_warp(K, K_inverse, T)
            pairs.KRKi[host, target], pairs.Kt[host, target] = KRKi.astype(np.float32), Kt.astype(np.float32)
            ratio = keyframes.exposure[target] / keyframes.exposure[host]
            gain = ratio * np.exp(keyframes.affine[target, 0] - keyframes.affine[host, 0])
            pairs.gain[host, target] = gain
            pairs.offset[host, target] = keyframes.affine[target, 1] - gain * keyframes.affine[host, 1]
            pairs.R_eval[host, target] = T_eval[:3, :3].astype(np.float32)
            pairs.t_eval[host, target] = T_eval[:3, 3].astype(np.float32)
            pairs.gain_eval[host, target] = ratio * np.exp(
                keyframes.affine_eval[target, 0] - keyframes.affine_eval[host, 0]
            )
            pairs.adjoint_eval[host, target] = se3.adjoint(T_eval)


def pair_geometry(keyframes: KeyframeArrays, n: int, intrinsics: np.ndarray) -> PairGeometry:
    """PairGeometry of the first n keyframes; intrinsics (4,) float64."""
    pairs = PairGeometry(
        KRKi=np.zeros((n, n, 3, 3), np.float32),
        Kt=np.zeros((n, n, 3), np.float32),
        gain=np.zeros((n, n), np.float32),
        offset=np.zeros((n, n), np.float32),
        R_eval=np.zeros((n, n, 3, 3), np.float32),
        t_eval=np.zeros((n, n, 3), np.float32),
        gain_eval=np.zeros((n, n), np.float32),
        adjoint_eval=np.zeros((n, n, 6, 6)),
    )
    fill_pairs(keyframes, n, intrinsics, pairs)
    return pairs


@kernel
def project_points(
    u: np.ndarray, v: np.ndarray, idepth: np.ndarray, host: np.ndarray, pairs: PairGeometry, target: int,
    x: np.ndarray, y: np.ndarray, new_idepth: np.ndarray,
) -> None:  # fmt: skip
    """Pixel and inverse depth of points in a target keyframe; float32. Points hosted there stay where they are."""
    for i in range(u.size):
        if host[i] == target:
            x[i], y[i], new_idepth[i] = u[i], v[i], idepth[i]
            continue
        warp = warp_of(pairs.KRKi[host[i], target], pairs.Kt[host[i], target])
        x[i], y[i], _, z_inverse = warp_point(warp, u[i], v[i], idepth[i])
        new_idepth[i] = idepth[i] * z_inverse
