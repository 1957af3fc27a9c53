# SPDX-License-Identifier: BSD-3-Clause
"""Normal equations of all sightings with the points eliminated (Schur complement), and the steps of the points.

The unknowns that the sightings of one point depend on are gathered in small arrays: lens and mount first, then the
host's, then those of each target. All arrays are float64.
"""

from typing import NamedTuple, Tuple

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel, kernel_inlined

CAMERA, KEYFRAME, POINT = 12, 6, 3  # unknowns, as in `state`, whose module no kernel imports
ALWAYS = CAMERA + KEYFRAME
OF_SIGHTING = ALWAYS + KEYFRAME


class Equations(NamedTuple):
    """The sightings of all points, linearised and whitened.

    Attributes:
        first, host, target: of `Tracks`.
        offset: number of the first keyframe's first unknown.
        of_camera, of_host, of_target, of_point: derivatives (M, 2, .).
        residual: (M, 2).
        own, pull: (P, 3, 3) and (P, 3), information and gradient of each point alone.
    """

    first: np.ndarray
    host: np.ndarray
    target: np.ndarray
    offset: int
    of_camera: np.ndarray
    of_host: np.ndarray
    of_target: np.ndarray
    of_point: np.ndarray
    residual: np.ndarray
    own: np.ndarray
    pull: np.ndarray


@kernel_inlined
def _inverse(H: np.ndarray, result: np.ndarray) -> None:
    """Inverse of a symmetric (3, 3) matrix."""
    a, b, c, d, e, f = H[0, 0], H[0, 1], H[0, 2], H[1, 1], H[1, 2], H[2, 2]
    A, B, C = d * f - e * e, c * e - b * f, b * e - c * d
    scale = 1.0 / (a * A + b * B + c * C)
    result[0, 0], result[0, 1], result[0, 2] = A * scale, B * scale, C * scale
    result[1, 1], result[1, 2], result[2, 2] = (a * f - c * c) * scale, (b * c - a * e) * scale, (a * d - b * b) * scale
    result[1, 0], result[2, 0], result[2, 1] = result[0, 1], result[0, 2], result[1, 2]


@kernel
def _gather(
    equations: Equations, p: int, H: np.ndarray, g: np.ndarray, mixed: np.ndarray, own: np.ndarray, b: np.ndarray,
    whole: bool,
) -> int:  # fmt: skip
    """Add the sightings of one point to its small arrays; returns how many unknowns they have.

    Args:
        equations: of all points.
        p: the point.
        H, g: (n, n) lower half and (n,), set, if they are wanted.
        mixed: (n, 3) with the point, set.
        own, b: (3, 3) and (3,) of the point, set.
        whole: they are wanted.
    """
    start, end = equations.first[p], equations.first[p + 1]
    of_camera, of_host, of_target, of_point, residual = (
        equations.of_camera, equations.of_host, equations.of_target, equations.of_point, equations.residual,
    )  # fmt: skip
    own[:], b[:] = equations.own[p], equations.pull[p]
    size = ALWAYS + KEYFRAME * (end - start)
    mixed[:size] = 0.0
    if whole:
        H[:size, :size] = 0.0
        g[:size] = 0.0
    row = np.empty(OF_SIGHTING)
    for m in range(start, end):
        at = KEYFRAME * (m - start)  # of this target's unknowns, behind ALWAYS
        for axis in range(2):
            r = residual[m, axis]
            for k in range(CAMERA):
                row[k] = of_camera[m, axis, k]
            for k in range(KEYFRAME):
                row[CAMERA + k] = of_host[m, axis, k]
                row[ALWAYS + k] = of_target[m, axis, k]
            for k in range(POINT):
                b[k] += of_point[m, axis, k] * r
                for n in range(POINT):
                    own[k, n] += of_point[m, axis, k] * of_point[m, axis, n]
            for i in range(OF_SIGHTING):
                to = i if i < ALWAYS else at + i
                value = row[i]
                for k in range(POINT):
                    mixed[to, k] += value * of_point[m, axis, k]
                if whole:
                    g[to] += value * r
                    for j in range(min(i + 1, ALWAYS)):
                        H[to, j] += value * row[j]
                    for j in range(ALWAYS, i + 1):
                        H[to, at + j] += value * row[j]
    return size


@kernel_inlined
def _unknown(equations: Equations, p: int, i: int) -> int:
    """Number of an unknown of a point's small arrays among all unknowns."""
    if i < CAMERA:
        return i
    if i < ALWAYS:
        return equations.offset + KEYFRAME * equations.host[p] + i - CAMERA
    number = (i - ALWAYS) // KEYFRAME
    keyframe = equations.target[equations.first[p] + number]
    return equations.offset + KEYFRAME * keyframe + i - ALWAYS - KEYFRAME * number


@kernel
def _arrays(first: np.ndarray) -> Tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Small arrays H, g, mixed, own and b as in `_gather` for the point with the most sightings, and own's inverse."""
    most = ALWAYS + KEYFRAME * np.max(np.diff(first))
    return (
        np.zeros((most, most)), np.zeros(most), np.zeros((most, POINT)),
        np.zeros((POINT, POINT)), np.zeros(POINT), np.zeros((POINT, POINT)),
    )  # fmt: skip


@kernel
def add_sightings(equations: Equations, cluster: np.ndarray, H: np.ndarray, scores: np.ndarray) -> None:
    """Add to the normal equations of lens, mount and keyframes.

    Args:
        equations: of all points.
        cluster: (P,) row of `scores` to which a point's gradient is added.
        H: (N, N) changed.
        scores: (C, N) changed; their sum is the gradient.
    """
    small, g, mixed, own, b, inverse = _arrays(equations.first)
    index, weighted = np.empty(g.size, np.int64), np.empty((g.size, POINT))
    for p in range(equations.host.size):
        size = _gather(equations, p, small, g, mixed, own, b, True)
        _inverse(own, inverse)
        for i in range(size):
            index[i] = _unknown(equations, p, i)
            for k in range(POINT):
                weighted[i, k] = mixed[i, 0] * inverse[0, k] + mixed[i, 1] * inverse[1, k] + mixed[i, 2] * inverse[2, k]
        score = scores[cluster[p]]
        for i in range(size):
            w0, w1, w2 = weighted[i, 0], weighted[i, 1], weighted[i, 2]
            score[index[i]] += g[i] - (w0 * b[0] + w1 * b[1] + w2 * b[2])
            for j in range(i):
                value = small[i, j] - (w0 * mixed[j, 0] + w1 * mixed[j, 1] + w2 * mixed[j, 2])
                H[index[i], index[j]] += value
                H[index[j], index[i]] += value
            H[index[i], index[i]] += small[i, i] - (w0 * mixed[i, 0] + w1 * mixed[i, 1] + w2 * mixed[i, 2])


@kernel
def point_steps(equations: Equations, step: np.ndarray) -> np.ndarray:
    """(P, 3) steps of the points that belong to a step (N,) of all the others."""
    result = np.zeros((equations.host.size, POINT))
    small, g, mixed, own, b, inverse = _arrays(equations.first)
    for p in range(equations.host.size):
        size = _gather(equations, p, small, g, mixed, own, b, False)
        _inverse(own, inverse)
        for i in range(size):
            moved = step[_unknown(equations, p, i)]
            for k in range(POINT):
                b[k] += mixed[i, k] * moved
        for k in range(POINT):
            result[p, k] = -(inverse[k, 0] * b[0] + inverse[k, 1] * b[1] + inverse[k, 2] * b[2])
    return result


@kernel
def sighting_scores(equations: Equations, group: np.ndarray, host_group: np.ndarray, scores: np.ndarray) -> None:
    """Add the gradient of each sighting and of each host's pixel, with the point eliminated, to rows of their groups.

    Args:
        equations: of all points.
        group: (M,) row of each sighting.
        host_group: (P,) row of each point's own gradient.
        scores: (G, N) changed.
    """
    small, g, mixed, own, b, inverse = _arrays(equations.first)
    offset, of_point, residual = equations.offset, equations.of_point, equations.residual
    for p in range(equations.host.size):
        size = _gather(equations, p, small, g, mixed, own, b, False)
        _inverse(own, inverse)
        x = inverse @ equations.pull[p]
        score = scores[host_group[p]]
        for i in range(size):
            score[_unknown(equations, p, i)] -= mixed[i, 0] * x[0] + mixed[i, 1] * x[1] + mixed[i, 2] * x[2]
        for m in range(equations.first[p], equations.first[p + 1]):
            score = scores[group[m]]
            for k in range(POINT):
                b[k] = of_point[m, 0, k] * residual[m, 0] + of_point[m, 1, k] * residual[m, 1]
            x = inverse @ b
            for i in range(size):
                score[_unknown(equations, p, i)] -= mixed[i, 0] * x[0] + mixed[i, 1] * x[1] + mixed[i, 2] * x[2]
            for axis in range(2):
                r = residual[m, axis]
                for k in range(CAMERA):
                    score[k] += equations.of_camera[m, axis, k] * r
                for k in range(KEYFRAME):
                    score[offset + KEYFRAME * equations.host[p] + k] += equations.of_host[m, axis, k] * r
                    score[offset + KEYFRAME * equations.target[m] + k] += equations.of_target[m, axis, k] * r
