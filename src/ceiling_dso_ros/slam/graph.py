# SPDX-License-Identifier: BSD-3-Clause
"""The pose graph of the map: gtsam with native factors."""

from typing import Dict, Iterable, List, Sequence

import gtsam
import numpy as np

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.slam.deciding import carried, distance
from ceiling_dso_ros.slam.site_map import Edge

ANCHOR_SIGMA = 1e-4  # metres and rad: where the map begins
LARGEST_BEND = 14.16  # squared Mahalanobis distance, 3 sigma of three dimensions
GNC_PROBABILITY = 0.99  # with which a right loop is within the inliers' threshold
LEAST_WEIGHT = 0.5


class PoseGraph:
    """Poses of keyframes, by number, and the edges between them.

    Attributes:
        poses: number -> (3,) pose in map.
        edges: all edges.
    """

    def __init__(self) -> None:
        self.poses: Dict[int, np.ndarray] = {}
        self.edges: List[Edge] = []

    def predicted(self, start: int, end: int) -> np.ndarray:
        """T_start_end by the estimate, (3,)."""
        return planar.between(self.poses[start], self.poses[end])

    def covariances_from(self, end: int, starts: Iterable[int]) -> Dict[int, np.ndarray]:
        """Covariance of T_start_end of several starts, (3, 3) each."""
        marginals = gtsam.Marginals(_factors(self.poses, self.edges), _values(self.poses))
        result = {}
        for start in starts:
            keys = gtsam.KeyVector([start, end])
            joint = marginals.jointMarginalCovariance(keys)
            to_end = -planar.adjoint(planar.inverse(self.predicted(start, end)))
            cross = to_end @ joint.at(start, end)
            result[start] = to_end @ joint.at(start, start) @ to_end.T + cross + cross.T + joint.at(end, end)
        return result

    def close(self, loops: Sequence[Edge]) -> str:
        """Add loops and solve the graph, or change nothing.

        Returns:
            Why they were not added, in words; empty if they were.
        """
        edges = [*self.edges, *loops]
        try:
            outliers = len(loops) - len(_inliers(self.poses, self.edges, loops))
            if outliers:
                return f"{outliers} of {len(loops)} loops are outliers of the graph"
            poses = _solved(self.poses, edges)
        except RuntimeError as error:
            return f"the graph has no solution: {error}"
        bend = max((_bend(poses, edge) for edge in edges if not edge.is_loop), default=0.0)
        if bend > LARGEST_BEND:
            return f"a motion of the odometry would have to bend by {np.sqrt(bend):.1f} sigma"
        self.poses, self.edges = poses, edges
        return ""

    def let_go(self, number: int) -> None:
        """Remove a keyframe with one edge of the odometry to it and one from it: they become one.

        A loop that ends here is continued by the next edge of the odometry, unless the next keyframe has its own.
        """
        into = [edge for edge in self.edges if edge.end == number]
        out = [edge for edge in self.edges if edge.start == number]
        rest = [edge for edge in self.edges if number not in (edge.start, edge.end)]
        for after in (edge for edge in out if not edge.is_loop):
            has_loop = any(edge.is_loop and edge.end == after.end for edge in rest)
            for before in into:
                if not (before.is_loop and has_loop):
                    rest.append(_chained(before, after))
        del self.poses[number]
        self.edges = rest


def _chained(before: Edge, after: Edge) -> Edge:
    motion = planar.compose(before.motion, after.motion)
    covariance = carried(before.covariance, after.motion, after.covariance)
    return Edge(before.start, after.end, motion, covariance, before.is_loop)


def _bend(poses: Dict[int, np.ndarray], edge: Edge) -> float:
    return distance(edge.motion, edge.covariance, planar.between(poses[edge.start], poses[edge.end]))


def _values(poses: Dict[int, np.ndarray]) -> gtsam.Values:
    values = gtsam.Values()
    for number, pose in poses.items():
        values.insert(number, gtsam.Pose2(*pose))
    return values


def _factors(poses: Dict[int, np.ndarray], edges: Sequence[Edge]) -> gtsam.NonlinearFactorGraph:
    graph = gtsam.NonlinearFactorGraph()
    first = min(poses)
    anchor = gtsam.noiseModel.Isotropic.Sigma(3, ANCHOR_SIGMA)
    graph.push_back(gtsam.PriorFactorPose2(first, gtsam.Pose2(*poses[first]), anchor))
    for edge in edges:
        noise = gtsam.noiseModel.Gaussian.Covariance(edge.covariance)
        graph.push_back(gtsam.BetweenFactorPose2(edge.start, edge.end, gtsam.Pose2(*edge.motion), noise))
    return graph


def _solved(poses: Dict[int, np.ndarray], edges: Sequence[Edge]) -> Dict[int, np.ndarray]:
    values = gtsam.LevenbergMarquardtOptimizer(_factors(poses, edges), _values(poses)).optimize()
    found = {number: values.atPose2(number) for number in poses}
    return {number: np.array([pose.x(), pose.y(), pose.theta()]) for number, pose in found.items()}


def _inliers(poses: Dict[int, np.ndarray], edges: Sequence[Edge], loops: Sequence[Edge]) -> List[Edge]:
    """Those of the new loops that graduated non-convexity keeps while all known edges are inliers."""
    graph = _factors(poses, [*edges, *loops])
    parameters = gtsam.GncLMParams()
    parameters.setKnownInliers(list(range(len(edges) + 1)))
    optimizer = gtsam.GncLMOptimizer(graph, _values(poses), parameters)
    optimizer.setInlierCostThresholdsAtProbability(GNC_PROBABILITY)
    optimizer.optimize()
    weights = np.array(optimizer.getWeights())[len(edges) + 1 :]
    return [loop for loop, weight in zip(loops, weights) if weight > LEAST_WEIGHT]
