# SPDX-License-Identifier: BSD-3-Clause
"""What is known of a camera on a vehicle: it moves in a plane, and turns about the plane's normal alone.

Images determine one motion badly: a slow tilt together with a shift, as if the ceiling were twisted or bent. Where few
edges tell depth, nothing else stops it. Two keyframes i and j see the normal n in the same direction, and each lies in
the plane of the other:

    e = (B^T R_ij n, n . t_ij) = 0,

with T_ij the motion from camera j to camera i, and B, (3, 2), orthogonal to n. Vehicles wobble and floors are uneven,
so this holds within standard deviations that grow with the distance. The normal itself is known only as well as the
camera is mounted. An error of it by dn changes e by (B^T (R_ij - 1) dn, dn . t_ij): nothing about the tilt where the
vehicle drives straight on, which is where images need it.
"""

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel

# Tilt and height of one keyframe against another: by wobbling, and by the unevenness of the floor on the way between.
TILT_RAD, TILT_RAD_PER_UNIT = 0.003, 0.01
HEIGHT, HEIGHT_PER_UNIT = 0.001, 0.005
# Of the normal: two degrees, as cameras are mounted by hand. A calibrated mount is better, but nobody says which it is.
NORMAL_RAD = 0.035
# Of the photometric energy: its usual error of 3 grey levels, squared, times the correlation of neighbouring points.
ENERGY = 100.0


@kernel
def cross_matrix(v: np.ndarray) -> np.ndarray:
    """Matrix (3, 3) of the cross product: times x it is v x x."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


@kernel
def variances(R: np.ndarray, way2: float) -> np.ndarray:
    """(3,) float64 variances of e for a pair of keyframes with a rotation (3, 3) and a squared distance."""
    turn2 = 3.0 - R[0, 0] - R[1, 1] - R[2, 2]  # (2 sin(angle / 2))^2: how far the rotation moves what it turns
    tilt = TILT_RAD * TILT_RAD + TILT_RAD_PER_UNIT * TILT_RAD_PER_UNIT * way2 + NORMAL_RAD * NORMAL_RAD * turn2
    height = HEIGHT * HEIGHT + (HEIGHT_PER_UNIT * HEIGHT_PER_UNIT + NORMAL_RAD * NORMAL_RAD) * way2
    return np.array([tilt, tilt, height])


@kernel
def add_planar_motion(
    normal: np.ndarray, T_camera_world: np.ndarray, first: int, size: int, H: np.ndarray, b: np.ndarray
) -> None:
    """Add the constraint between every two keyframes to their normal equations H x = -b.

    n keyframes have n (n - 1) / 2 pairs, but only n - 1 of them are independent: each counts for 2 / n.

    Args:
        normal: (3,) float64 normal of the plane in the camera's frame, a unit vector.
        T_camera_world: (n, 4, 4) float64 of the keyframes.
        first, size: column of the first keyframe's left increment (translation, rotation), and columns per keyframe.
        H, b: (columns, columns) and (columns,) float64.
    """
    n = T_camera_world.shape[0]
    axis = np.zeros(3)
    axis[np.argmin(np.abs(normal))] = 1.0
    B = np.empty((3, 3))
    B[0] = np.cross(normal, axis)
    B[0] /= np.sqrt((B[0] * B[0]).sum())
    B[1] = np.cross(normal, B[0])
    B[2] = normal
    weight = 2.0 * ENERGY / n
    J = np.zeros((3, 12))
    e = np.empty(3)
    for i in range(n):
        R_i, t_i = np.ascontiguousarray(T_camera_world[i, :3, :3]), T_camera_world[i, :3, 3].copy()
        for j in range(i):
            R_j, t_j = np.ascontiguousarray(T_camera_world[j, :3, :3]), T_camera_world[j, :3, 3].copy()
            R = R_i @ R_j.T
            t = t_i - R @ t_j
            seen = R @ normal
            e[:2] = B[:2] @ seen
            e[2] = normal @ t
            J[:2, 3:6] = -B[:2] @ cross_matrix(seen)
            J[:2, 9:12] = B[:2] @ R @ cross_matrix(normal)
            J[2, :3] = normal
            J[2, 3:6] = -normal @ cross_matrix(t)
            J[2, 6:9] = -normal @ R
            information = weight / variances(R, (t * t).sum())
            for a in range(12):
                row = first + size * (i if a < 6 else j) + a % 6
                for k in range(3):
                    weighted = information[k] * J[k, a]
                    b[row] += weighted * e[k]
                    for c in range(12):
                        H[row, first + size * (i if c < 6 else j) + c % 6] += weighted * J[k, c]
