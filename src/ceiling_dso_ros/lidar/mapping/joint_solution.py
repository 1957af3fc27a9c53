# SPDX-License-Identifier: BSD-3-Clause
"""Poses and map at once: the keyframes that fit best to the lines through the points of all of them.

Each landmark is a line that is estimated with the poses, so the covariance of the poses includes that of the map, and
the drift where no landmark connects two places. Weak relations hold the poses where the points leave them open.
"""

from dataclasses import dataclass
from typing import List, Sequence, Tuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from ceiling_dso_ros.lidar.config import LidarConfig
from ceiling_dso_ros.lidar.mapping.elimination_kernels import eliminate_landmarks
from ceiling_dso_ros.lidar.mapping.graph import Relation
from ceiling_dso_ros.lidar.mapping.landmarks import KeyframePoints, LandmarkMap, find_landmarks
from ceiling_dso_ros.lidar.scans.poses import wrap

MOST_ITERATIONS = 15
FLICKER = 20.0  # times the steps that end the iterations: if they shrink no more, landmarks come and go
FAR = 9.0  # squared Mahalanobis distance at which a relation has half of its weight
GAUGE_INFORMATION = 1e6  # of the three motions of the whole that nothing determines
SMALLEST_SIGMA_M = 0.002  # of a surface


@dataclass(frozen=True)
class JointSolution:
    """The best poses of the keyframes with their map.

    Attributes:
        poses: (K, 3).
        landmark_map: lines through the points of all keyframes.
        information: (3 K, 3 K) of x, y, yaw of all poses; any motion of the whole has none.
        iterations: how often the map was made.
    """

    poses: np.ndarray
    landmark_map: LandmarkMap
    information: np.ndarray
    iterations: int


def solve_jointly(
    keyframes: KeyframePoints, poses: np.ndarray, relations: Sequence[Relation], config: LidarConfig
) -> JointSolution:
    """Improve the poses of keyframes; the map is made again from the poses until they no longer move.

    Args:
        keyframes: points of all of them.
        poses: (K, 3) first guess, right within about the size of a landmark.
        relations: between them, which count little where the points say more.
        config: settings.

    Raises:
        InputError: the points are too far from each other.
    """
    poses = poses.copy()
    iterations, last_size = 0, np.inf
    while True:
        landmark_map = find_landmarks(keyframes, poses, config.landmark_m, SMALLEST_SIGMA_M)
        information, gradient = _normal_equations(keyframes, poses, landmark_map, relations)
        if iterations == MOST_ITERATIONS:
            break
        gauge = gauge_motions(poses)
        step = -cho_solve(cho_factor(information + GAUGE_INFORMATION * gauge @ gauge.T), gradient).reshape(-1, 3)
        poses += step
        iterations += 1
        size = float(np.abs(step / (config.converged_m, config.converged_m, config.converged_rad)).max())
        if size < 1.0 or (size < FLICKER and size > 0.5 * last_size):
            break
        last_size = size
    poses[:, 2] = wrap(poses[:, 2])
    return JointSolution(poses, landmark_map, information, iterations)


def _normal_equations(
    keyframes: KeyframePoints,
    poses: np.ndarray,
    landmark_map: LandmarkMap,
    relations: Sequence[Relation],
) -> Tuple[np.ndarray, np.ndarray]:
    size = 3 * len(poses)
    information, gradient = np.zeros((size, size)), np.zeros(size)
    members, sums = landmark_map.sum_groups(keyframes, poses)
    eliminate_landmarks(members, sums, landmark_map.lines, information, gradient)
    for first, second, own, right in _relation_blocks(poses, relations):
        rows = np.r_[3 * first : 3 * first + 3, 3 * second : 3 * second + 3]
        information[np.ix_(rows, rows)] += own
        gradient[rows] += right
    return information, gradient


def _relation_blocks(poses: np.ndarray, relations: Sequence[Relation]) -> List[Tuple[int, int, np.ndarray, np.ndarray]]:
    """First, second, (6, 6) information and (6,) gradient of each relation; outliers count less (Cauchy)."""
    blocks = []
    for relation in relations:
        a, b = poses[relation.first], poses[relation.second]
        c, s = np.cos(a[2]), np.sin(a[2])
        back = np.array([[c, s], [-s, c]])
        seen = back @ (b[:2] - a[:2])
        cm, sm = np.cos(relation.moved[2]), np.sin(relation.moved[2])
        turned = np.array([[cm, sm], [-sm, cm]])
        error = np.append(turned @ (seen - relation.moved[:2]), wrap(b[2] - a[2] - relation.moved[2]))
        J = np.zeros((3, 6))
        J[:2, :2], J[:2, 3:5] = -turned @ back, turned @ back
        J[:2, 2] = turned @ (seen[1], -seen[0])
        J[2, 2], J[2, 5] = -1.0, 1.0
        weighted = np.linalg.inv(relation.covariance)
        weighted *= 1.0 / (1.0 + error @ weighted @ error / FAR)
        blocks.append((relation.first, relation.second, J.T @ weighted @ J, J.T @ weighted @ error))
    return blocks


def gauge_motions(poses: np.ndarray) -> np.ndarray:
    """(3 K, 3) orthonormal motions of the whole: along x, along y, and turned about its middle."""
    count = len(poses)
    motions = np.zeros((count, 3, 3))
    motions[:, 0, 0] = motions[:, 1, 1] = 1.0
    centred = poses[:, :2] - poses[:, :2].mean(axis=0)
    motions[:, 0, 2], motions[:, 1, 2], motions[:, 2, 2] = -centred[:, 1], centred[:, 0], 1.0
    flat = motions.reshape(3 * count, 3)
    return flat / np.linalg.norm(flat, axis=0)
