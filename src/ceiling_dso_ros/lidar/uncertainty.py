# SPDX-License-Identifier: BSD-3-Clause
"""How sure the poses are, after the whole trajectory has been aligned, as `evaluate` does before it compares."""

import numpy as np

from ceiling_dso_ros.lidar.mapping.joint_solution import GAUGE_INFORMATION, gauge_motions

CORRIDOR_RATIO = 0.03  # of the information along and across: below it, a scan tells hardly where the robot is along
ANY_SPEED_M_S, ANY_ACCELERATION_M_S2 = 1.0, 1.0  # of a robot of which nothing is known


def keyframe_covariances(information: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """Covariances (K, 3, 3) of x, y, yaw of each keyframe.

    The frame of the map is the one in which the errors of the positions of all poses are smallest. With the motions M
    of the whole, errors d become d - M (M' W M)^-1 M' W d, where W counts the positions: W. Baarda's S-transformation.

    Args:
        information: (3 K, 3 K) of all poses, of which the motions of the whole have none.
        poses: (K, 3).
    """
    motions = gauge_motions(poses)
    own_motions = motions @ motions.T
    covariance = np.linalg.inv(information + GAUGE_INFORMATION * own_motions) - own_motions / GAUGE_INFORMATION
    weights = np.tile((1.0, 1.0, 0.0), len(poses))
    aligned = motions @ np.linalg.pinv(motions.T @ (weights[:, None] * motions)) @ (motions.T * weights)
    covariance = covariance - aligned @ covariance
    covariance = covariance - covariance @ aligned.T
    blocks = covariance.reshape(len(poses), 3, len(poses), 3)
    own = np.einsum("kikj->kij", blocks)
    return positive(0.5 * (own + own.transpose(0, 2, 1)))


def scan_covariances(
    keyframe_covariances: np.ndarray, keyframe_own: np.ndarray, nearest: np.ndarray, own: np.ndarray
) -> np.ndarray:
    """Covariances (N, 3, 3) of all scans: that of the map around the nearest keyframe, and that of their own points.

    Args:
        keyframe_covariances: (K, 3, 3).
        keyframe_own: (K, 3, 3) what their own points tell, in a map that is exact.
        nearest: (N,) index of the keyframe whose map a scan was localised in.
        own: (N, 3, 3) the same of the scans.
    """
    of_map = positive(keyframe_covariances - keyframe_own)
    return of_map[nearest] + own


def positive(matrices: np.ndarray) -> np.ndarray:
    """The nearest (N, 3, 3) symmetric matrices without negative eigenvalues."""
    scale = np.array([1.0, 1.0, 10.0])  # yaw in units of decimetres at one metre: eigenvalues are comparable
    values, vectors = np.linalg.eigh(matrices * np.outer(scale, scale))
    return np.einsum("nij,nj,nkj->nik", vectors, np.maximum(values, 0.0), vectors) / np.outer(scale, scale)


def translation_eigenvalues(informations: np.ndarray) -> np.ndarray:
    """(N, 2) eigenvalues of the information of x and y where yaw is unknown, the smaller one first, 1/m^2.

    The smaller one is that along a corridor.
    """
    yaw = np.maximum(informations[:, 2, 2], 1e-12)
    cross = informations[:, :2, 2]
    reduced = informations[:, :2, :2] - cross[:, :, None] * cross[:, None, :] / yaw[:, None, None]
    return np.maximum(np.linalg.eigvalsh(reduced), 0.0)


def is_corridor(informations: np.ndarray) -> np.ndarray:
    """(N,) bool: scans that tell where the robot is across, but hardly where along."""
    small, large = translation_eigenvalues(informations).T
    return small < CORRIDOR_RATIO * large


def unseen_covariances(times_s: np.ndarray, informations: np.ndarray, is_driven: np.ndarray) -> np.ndarray:
    """Covariances (N, 3, 3) of motion that neither scans nor wheels tell: along a corridor, or where nothing is seen.

    The pose there is guessed from the velocity before. Over a stretch of T seconds it may be wrong by any acceleration,
    a T^2 / 2, and by any speed, v T / 2, of which the smaller one counts. It counts for the whole stretch, because an
    alignment spreads it.

    Args:
        times_s: (N,) of the scans.
        informations: (N, 3, 3) of their points.
        is_driven: (N,) bool, where wheels tell the motion.
    """
    yaw = np.maximum(informations[:, 2, 2], 1e-12)
    cross = informations[:, :2, 2]
    values, vectors = np.linalg.eigh(
        informations[:, :2, :2] - cross[:, :, None] * cross[:, None, :] / yaw[:, None, None]
    )
    usual = float(np.median(values[:, 1]))
    found = np.zeros((len(times_s), 3, 3))
    for direction in range(2):
        weak = (values[:, direction] < CORRIDOR_RATIO * usual) & ~is_driven
        edges = np.flatnonzero(np.diff(np.concatenate([[False], weak, [False]]).astype(np.int8)))
        for begin, end in edges.reshape(-1, 2):
            before_s, after_s = times_s[max(begin - 1, 0)], times_s[min(end, len(times_s) - 1)]
            lasting_s = float(after_s - before_s)
            sigma_m = min(0.5 * ANY_SPEED_M_S * lasting_s, 0.5 * ANY_ACCELERATION_M_S2 * lasting_s**2)
            along = vectors[begin:end, :, direction]
            found[begin:end, :2, :2] += sigma_m**2 * along[:, :, None] * along[:, None, :]
    return found


def position_sigmas(covariances: np.ndarray) -> np.ndarray:
    """(N,) root of the mean squared distance from the truth, metres."""
    return np.sqrt(np.maximum(covariances[:, 0, 0] + covariances[:, 1, 1], 0.0))


def yaw_sigmas(covariances: np.ndarray) -> np.ndarray:
    """(N,) radians."""
    return np.sqrt(np.maximum(covariances[:, 2, 2], 0.0))


def normalised_errors(errors: np.ndarray, covariances: np.ndarray) -> np.ndarray:
    """(N,) squared Mahalanobis distances of (N, 3) errors x, y, yaw, over three: 1 in the mean if all is right."""
    return np.einsum("ni,ni->n", errors, np.linalg.solve(covariances, errors[..., None])[..., 0]) / 3.0


def aligned_errors(poses: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """(N, 3) errors x, y, yaw in the frame of the poses, after the best alignment of the positions.

    Args:
        poses: (N, 3).
        truth: (N, 3) of the same moments, in any frame.
    """
    p, t = poses[:, :2], truth[:, :2]
    p0, t0 = p - p.mean(axis=0), t - t.mean(axis=0)
    cross = np.sum(t0[:, 0] * p0[:, 1] - t0[:, 1] * p0[:, 0])
    dot = np.sum(t0 * p0)
    if np.hypot(cross, dot) > 1e-3:
        yaw = np.arctan2(cross, dot)
    else:  # the robot stands: its yaws tell
        yaw = np.angle(np.exp(1j * (poses[:, 2] - truth[:, 2])).mean())
    c, s = np.cos(yaw), np.sin(yaw)
    moved = t0 @ np.array([[c, s], [-s, c]]) + p.mean(axis=0)
    turn = np.pi - (np.pi - (poses[:, 2] - truth[:, 2] - yaw)) % (2.0 * np.pi)
    return np.column_stack([p - moved, turn])
