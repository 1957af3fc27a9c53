# SPDX-License-Identifier: BSD-3-Clause
"""Residuals of the sightings of points, in pixels of the raw image, and their derivatives.

With the ray r of a point in the host h, its inverse depth d, and the mount (R, a), the point is seen in the target t at

    q = R^T (T_t^-1 T_h (R r + d a) - d a),   all multiplied by d, which the projection cancels.
"""

from typing import NamedTuple, Tuple

import numpy as np

from ceiling_dso_ros.lens.parameters import by_parameters, by_ray, pixels_of
from ceiling_dso_ros.lens.state import OF_CAMERA, DriveState
from ceiling_dso_ros.lens.tracks import Tracks

LEAST_DEPTH = 0.05  # of q's third coordinate: nearer to the image plane nothing is seen


class SightingDerivatives(NamedTuple):
    """By the unknowns of lens and mount (M, 2, 12), host and target (M, 2, 6) each, and point (M, 2, 3)."""

    of_camera: np.ndarray
    of_host: np.ndarray
    of_target: np.ndarray
    of_point: np.ndarray


def cross_matrices(vectors: np.ndarray) -> np.ndarray:
    """(N, 3, 3) matrices of the cross products with vectors (N, 3)."""
    result = np.zeros((len(vectors), 3, 3))
    x, y, z = vectors.T
    result[:, 0, 1], result[:, 0, 2], result[:, 1, 2] = -z, y, -x
    result[:, 1, 0], result[:, 2, 0], result[:, 2, 1] = z, -y, x
    return result


class _Geometry(NamedTuple):
    """The chain of equations for each sighting; see the module."""

    A: np.ndarray  # (3, 3) rotation of the mount
    a: np.ndarray  # (3,) position of the mount
    turn: np.ndarray  # (M, 3, 3) host to target, in base_link
    shift: np.ndarray  # (M, 3) position of the host's base in the target's
    ray: np.ndarray  # (M, 3) R r, in the host's base
    in_host: np.ndarray  # (M, 3) R r + d a
    in_target: np.ndarray  # (M, 3)
    q: np.ndarray  # (M, 3)
    idepth: np.ndarray  # (M, 1)


def _geometry(state: DriveState, tracks: Tracks) -> _Geometry:
    point = tracks.point
    A, a = state.T_base_camera[:3, :3], state.T_base_camera[:3, 3]
    host, target = state.T_world_base[tracks.host[point]], state.T_world_base[tracks.target]
    back = np.swapaxes(target[:, :3, :3], 1, 2)
    turn = back @ host[:, :3, :3]
    shift = np.einsum("nij,nj->ni", back, host[:, :3, 3] - target[:, :3, 3])
    idepth = state.idepth[point][:, None]
    ray = np.column_stack([state.ray[point], np.ones(len(point))]) @ A.T
    in_host = ray + idepth * a
    in_target = np.einsum("nij,nj->ni", turn, in_host) + idepth * shift
    return _Geometry(A, a, turn, shift, ray, in_host, in_target, (in_target - idepth * a) @ A, idepth)


def residuals(state: DriveState, tracks: Tracks) -> Tuple[np.ndarray, np.ndarray]:
    """(M, 2) predicted minus measured pixels, and whether each sighting is in front of the camera, (M,) bool."""
    q = _geometry(state, tracks).q
    ahead = q[:, 2] > LEAST_DEPTH
    q = np.where(ahead[:, None], q, [0.0, 0.0, 1.0])
    return pixels_of(state.lens, q[:, :2] / q[:, 2:]) - tracks.pixel, ahead


def derivatives(state: DriveState, tracks: Tracks) -> SightingDerivatives:
    """Of the residuals."""
    g = _geometry(state, tracks)
    q = np.where(g.q[:, 2:] > LEAST_DEPTH, g.q, [0.0, 0.0, 1.0])
    seen = q[:, :2] / q[:, 2:]
    division = np.zeros((len(q), 2, 3))
    division[:, 0, 0] = division[:, 1, 1] = 1.0 / q[:, 2]
    division[:, :, 2] = -seen / q[:, 2:]
    in_camera = by_ray(state.lens, seen) @ division @ g.A.T  # of the pixel by a vector in the target's base
    turned = in_camera @ g.turn
    d = g.idepth[:, :, None]
    of_host = np.concatenate([d * turned, -turned @ cross_matrices(g.in_host)], axis=2)
    of_target = np.concatenate([-d * in_camera, in_camera @ cross_matrices(g.in_target)], axis=2)

    at_host = by_ray(state.lens, state.ray)
    back = np.linalg.inv(at_host)
    by_ray_of_host = turned @ g.A[:, :2]
    point = tracks.point
    lens = by_parameters(state.lens, seen) - by_ray_of_host @ (back @ by_parameters(state.lens, state.ray))[point]
    position = d * (turned - in_camera)
    rotation = -turned @ cross_matrices(g.ray) + in_camera @ cross_matrices(g.in_target - g.idepth * g.a)
    of_camera = np.concatenate([lens, position, rotation], axis=2)
    assert of_camera.shape[2] == OF_CAMERA
    by_idepth = (g.turn @ g.a + g.shift - g.a)[:, :, None]
    of_point = np.concatenate([by_ray_of_host @ back[point], in_camera @ by_idepth], axis=2)
    return SightingDerivatives(of_camera, of_host, of_target, of_point)
