# SPDX-License-Identifier: BSD-3-Clause
"""The graph of keyframes: motions from scan to scan, of the wheels, and loops, of which some may be wrong.

Graduated non-convexity decides which of them are: H. Yang et al., "Graduated non-convexity for robust spatial
perception", RA-L 2020. All factors are gtsam's own.
"""

from dataclasses import dataclass
from typing import List, Sequence

import gtsam
import numpy as np

INLIER_PROBABILITY = 0.999  # of a right loop's error to be taken for that of a right loop
PRIOR_SIGMAS = np.array([1e-6, 1e-6, 1e-6])  # of the first keyframe, which is the origin


@dataclass(frozen=True)
class Relation:
    """The pose of one keyframe seen from another.

    Attributes:
        first, second: their indices.
        moved: (3,) pose of the second seen from the first.
        covariance: (3, 3) of its error, seen from the second.
    """

    first: int
    second: int
    moved: np.ndarray
    covariance: np.ndarray


@dataclass(frozen=True)
class GraphSolution:
    """Poses of all keyframes (K, 3), and for each doubtful relation whether it is right."""

    poses: np.ndarray
    is_right: np.ndarray


def solve_graph(poses: np.ndarray, certain: Sequence[Relation], doubtful: Sequence[Relation]) -> GraphSolution:
    """The most likely poses.

    Args:
        poses: (K, 3) first guess; the first one stays.
        certain: connect all keyframes.
        doubtful: some of them may be wrong.
    """
    initial = gtsam.Values()
    for key, pose in enumerate(poses):
        initial.insert(key, gtsam.Pose2(*pose))
    graph = gtsam.NonlinearFactorGraph()
    prior = gtsam.noiseModel.Diagonal.Sigmas(PRIOR_SIGMAS)
    graph.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(*poses[0]), prior))
    for relation in (*certain, *doubtful):
        graph.add(_factor(relation))
    is_right = np.ones(len(doubtful), bool)
    if doubtful:
        parameters = gtsam.GncLMParams()
        parameters.setKnownInliers(list(range(1 + len(certain))))
        optimizer = gtsam.GncLMOptimizer(graph, initial, parameters)
        optimizer.setInlierCostThresholdsAtProbability(INLIER_PROBABILITY)
        initial = optimizer.optimize()
        is_right = np.asarray(optimizer.getWeights())[1 + len(certain) :] > 0.5
        graph = gtsam.NonlinearFactorGraph()
        graph.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(*poses[0]), prior))
        for relation in (*certain, *_right(doubtful, is_right)):
            graph.add(_factor(relation))
    solution = gtsam.LevenbergMarquardtOptimizer(graph, initial).optimize()
    found = [solution.atPose2(key) for key in range(len(poses))]
    return GraphSolution(np.array([[pose.x(), pose.y(), pose.theta()] for pose in found]), is_right)


def _factor(relation: Relation) -> gtsam.NonlinearFactor:
    noise = gtsam.noiseModel.Gaussian.Covariance(relation.covariance)
    return gtsam.BetweenFactorPose2(relation.first, relation.second, gtsam.Pose2(*relation.moved), noise)


def _right(relations: Sequence[Relation], is_right: np.ndarray) -> List[Relation]:
    return [relation for relation, right in zip(relations, is_right) if right]
