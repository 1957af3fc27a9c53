# SPDX-License-Identifier: BSD-3-Clause
"""Normal equations of all sightings with the points eliminated (Schur complement), and the steps of the points."""

from typing import Tuple

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel

CAMERA, KEYFRAME, POINT = 12, 6, 3  # unknowns, as in `state`, whose module no kernel imports


@kernel
def _of_point(
    p: int, first: np.ndarray, of_point: np.ndarray, residual: np.ndarray, own: np.ndarray, pull: np.ndarray
) -> Tuple[np.ndarray, np.ndarray]:
    """Inverse (3, 3) of a point's information, and its gradient (3,)."""
    H, b = own[p].copy(), pull[p].copy()
    for m in range(first[p], first[p + 1]):
        H += of_point[m].T @ of_point[m]
        b += of_point[m].T @ residual[m]
    return np.linalg.inv(H), b


@kernel
def _gathered(
    p: int, first: np.ndarray, host: np.ndarray, target: np.ndarray, offset: int, of_camera: np.ndarray,
    of_host: np.ndarray, of_target: np.ndarray, of_point: np.ndarray,
) -> Tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Unknowns (n,) that the sightings of a point depend on, and their information with the point's, (n, 3)."""
    count = first[p + 1] - first[p]
    index = np.empty(CAMERA + KEYFRAME * (1 + count), np.int64)
    mixed = np.zeros((index.size, POINT))
    for k in range(CAMERA):
        index[k] = k
    for k in range(KEYFRAME):
        index[CAMERA + k] = offset + KEYFRAME * host[p] + k
    for n in range(count):
        m = first[p] + n
        at = CAMERA + KEYFRAME * (1 + n)
        for k in range(KEYFRAME):
            index[at + k] = offset + KEYFRAME * target[m] + k
        mixed[:CAMERA] += of_camera[m].T @ of_point[m]
        mixed[CAMERA : CAMERA + KEYFRAME] += of_host[m].T @ of_point[m]
        mixed[at : at + KEYFRAME] = of_target[m].T @ of_point[m]
    return index, mixed


@kernel
def add_sightings(
    first: np.ndarray, host: np.ndarray, target: np.ndarray, offset: int, of_camera: np.ndarray, of_host: np.ndarray,
    of_target: np.ndarray, of_point: np.ndarray, residual: np.ndarray, own: np.ndarray, pull: np.ndarray,
    cluster: np.ndarray, H: np.ndarray, scores: np.ndarray,
) -> None:  # fmt: skip
    """Add to the normal equations of lens, mount and keyframes.

    Args:
        first, host, target: of `Tracks`.
        offset: number of the first keyframe's first unknown.
        of_camera, of_host, of_target, of_point: derivatives (M, 2, .), whitened.
        residual: (M, 2) whitened.
        own, pull: (P, 3, 3) and (P, 3), information and gradient of each point alone.
        cluster: (P,) row of `scores` to which a point's gradient is added.
        H: (N, N) changed.
        scores: (C, N) changed; their sum is the gradient.
    """
    for p in range(first.size - 1):
        inverse, b = _of_point(p, first, of_point, residual, own, pull)
        index, mixed = _gathered(p, first, host, target, offset, of_camera, of_host, of_target, of_point)
        n = index.size
        score = scores[cluster[p]]
        weighted = mixed @ inverse
        for i in range(n):
            score[index[i]] -= weighted[i, 0] * b[0] + weighted[i, 1] * b[1] + weighted[i, 2] * b[2]
            for j in range(n):
                H[index[i], index[j]] -= (
                    weighted[i, 0] * mixed[j, 0] + weighted[i, 1] * mixed[j, 1] + weighted[i, 2] * mixed[j, 2]
                )
        row = np.empty(CAMERA + 2 * KEYFRAME)
        for m in range(first[p], first[p + 1]):
            at = CAMERA + KEYFRAME * (1 + m - first[p])
            for axis in range(2):
                row[:CAMERA] = of_camera[m, axis]
                row[CAMERA : CAMERA + KEYFRAME] = of_host[m, axis]
                row[CAMERA + KEYFRAME :] = of_target[m, axis]
                for i in range(row.size):
                    global_i = index[i] if i < CAMERA + KEYFRAME else index[at + i - CAMERA - KEYFRAME]
                    score[global_i] += row[i] * residual[m, axis]
                    for j in range(row.size):
                        global_j = index[j] if j < CAMERA + KEYFRAME else index[at + j - CAMERA - KEYFRAME]
                        H[global_i, global_j] += row[i] * row[j]


@kernel
def point_steps(
    first: np.ndarray, host: np.ndarray, target: np.ndarray, offset: int, of_camera: np.ndarray, of_host: np.ndarray,
    of_target: np.ndarray, of_point: np.ndarray, residual: np.ndarray, own: np.ndarray, pull: np.ndarray,
    step: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """(P, 3) steps of the points that belong to a step (N,) of all the others; arguments as of `add_sightings`."""
    result = np.zeros((first.size - 1, POINT))
    for p in range(first.size - 1):
        inverse, b = _of_point(p, first, of_point, residual, own, pull)
        index, mixed = _gathered(p, first, host, target, offset, of_camera, of_host, of_target, of_point)
        for i in range(index.size):
            for k in range(POINT):
                b[k] += mixed[i, k] * step[index[i]]
        result[p] = -(inverse @ b)
    return result
