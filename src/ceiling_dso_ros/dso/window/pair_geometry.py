"""Relative geometry and brightness of every host-target pair, at the estimate and at the evaluation point."""

from typing import NamedTuple

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel
from ceiling_dso_ros.dso.compute.struct_of_arrays import struct_of_arrays
from ceiling_dso_ros.dso.geometry import se3
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
            pairs.KRKi[host, target] = (K @ np.ascontiguousarray(T[:3, :3]) @ K_inverse).astype(np.float32)
            pairs.Kt[host, target] = (K @ np.ascontiguousarray(T[:3, 3])).astype(np.float32)
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
