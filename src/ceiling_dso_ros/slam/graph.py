# SPDX-License-Identifier: BSD-3-Clause
"""The pose graph of the map: gtsam with native factors.

Factors and values are kept between the keyframes, and marginals are computed of the keyframes that are asked for: the
cost of a keyframe depends on the size of the graph, which is that of the area.
"""

from typing import Dict, Iterable, List, NamedTuple, Sequence

import gtsam
import numpy as np

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.slam.deciding import carried
from ceiling_dso_ros.slam.site_map import Edge

ANCHOR_SIGMA = 1e-4  # metres and rad: where the map begins
# Metres and rad. What is known less well than the first says nothing to first order, what is known better than the
# second nobody measures; gtsam calls a graph unsolvable in which an angle is 4096 times less certain than a position.
VAGUEST_SIGMA = np.array([100.0, 100.0, 1.0])
FINEST_SIGMA = np.array([3e-4, 3e-4, 1e-6])
LARGEST_BEND = 14.16  # squared Mahalanobis distance, 3 sigma of three dimensions
LARGEST_MISFIT = 11.34  # squared Mahalanobis distance of a loop that is right, one in a hundred exceeds it


class _Part(NamedTuple):
    """An edge with its factor."""

    edge: Edge
    factor: gtsam.BetweenFactorPose2


class PoseGraph:
    """Poses of keyframes, by number, and the edges between them.

    Attributes:
        poses: number -> (3,) pose in map; `place` adds one.
    """

    def __init__(self) -> None:
        self.poses: Dict[int, np.ndarray] = {}
        self._values = gtsam.Values()  # the same
        self._parts: List[_Part] = []

    @property
    def edges(self) -> List[Edge]:
        """All edges."""
        return [part.edge for part in self._parts]

    def place(self, number: int, pose: np.ndarray) -> None:
        """Add a keyframe at a (3,) pose in map."""
        self.poses[number] = np.asarray(pose, np.float64).copy()
        self._values.insert(number, gtsam.Pose2(*pose))

    def connect(self, edge: Edge) -> None:
        """Add an edge between two keyframes; no pose changes."""
        self._parts.append(_part(edge))

    def remove(self, numbers: Iterable[int]) -> None:
        """Remove keyframes with all of their edges."""
        gone = set(numbers)
        self._parts = [part for part in self._parts if not gone & {part.edge.start, part.edge.end}]
        for number in gone:
            self._erase(number)

    def predicted(self, start: int, end: int) -> np.ndarray:
        """T_start_end by the estimate, (3,)."""
        return planar.between(self.poses[start], self.poses[end])

    def covariances_from(self, end: int, starts: Sequence[int]) -> Dict[int, np.ndarray]:
        """Covariance of T_start_end of several starts, (3, 3) each."""
        joint = _Joint(self._factors([]).linearize(self._values), [end, *starts])
        result = {}
        for start in starts:
            to_end = -planar.adjoint(planar.inverse(self.predicted(start, end)))
            cross = to_end @ joint.between(start, end)
            result[start] = to_end @ joint.between(start, start) @ to_end.T + cross + cross.T + joint.between(end, end)
        return result

    def covariance(self, number: int) -> np.ndarray:
        """Covariance of a pose in map, (3, 3)."""
        return _Joint(self._factors([]).linearize(self._values), [number]).between(number, number)

    def close(self, loops: Sequence[Edge]) -> str:
        """Add loops and solve the graph, or change nothing.

        Every loop must agree with the solution that all of them have together. That is what graduated non-convexity
        would ask, too, before it keeps all of them, so only its first step is computed.

        Returns:
            Why they were not added, in words; empty if they were.
        """
        parts = [_part(loop) for loop in loops]
        try:
            values = gtsam.LevenbergMarquardtOptimizer(self._factors(parts), self._values).optimize()
        except RuntimeError as error:
            return f"the graph has no solution: {error}"
        outliers = sum(_bend(part, values) > LARGEST_MISFIT for part in parts)
        if outliers:
            return f"{outliers} of {len(loops)} loops are outliers of the graph"
        bend = max((_bend(part, values) for part in self._parts if not part.edge.is_loop), default=0.0)
        if bend > LARGEST_BEND:
            return f"a motion of the odometry would have to bend by {np.sqrt(bend):.1f} sigma"
        found = {number: values.atPose2(number) for number in self.poses}
        self.poses = {number: np.array([pose.x(), pose.y(), pose.theta()]) for number, pose in found.items()}
        self._values = values
        self._parts += parts
        return ""

    def let_go(self, number: int) -> None:
        """Remove a keyframe with one edge of the odometry to it and one from it: they become one.

        A loop that ends here is continued by the next edge of the odometry, unless the next keyframe has its own.
        """
        into = [part.edge for part in self._parts if part.edge.end == number]
        out = [part.edge for part in self._parts if part.edge.start == number]
        rest = [part for part in self._parts if number not in (part.edge.start, part.edge.end)]
        for after in (edge for edge in out if not edge.is_loop):
            has_loop = any(part.edge.is_loop and part.edge.end == after.end for part in rest)
            for before in into:
                if not (before.is_loop and has_loop):
                    rest.append(_part(_chained(before, after)))
        self._erase(number)
        self._parts = rest

    def _erase(self, number: int) -> None:
        del self.poses[number]
        self._values.erase(number)

    def _factors(self, further: Sequence[_Part]) -> gtsam.NonlinearFactorGraph:
        graph = gtsam.NonlinearFactorGraph()
        first = min(self.poses)
        anchor = gtsam.noiseModel.Isotropic.Sigma(3, ANCHOR_SIGMA)
        graph.push_back(gtsam.PriorFactorPose2(first, gtsam.Pose2(*self.poses[first]), anchor))
        for part in (*self._parts, *further):
            graph.push_back(part.factor)
        return graph


class _Joint:
    """Joint covariance of some poses of a linear graph; all others are eliminated."""

    def __init__(self, linear: gtsam.GaussianFactorGraph, numbers: Sequence[int]) -> None:
        ordering = gtsam.Ordering()
        for number in numbers:
            ordering.push_back(number)
        net = linear.marginalMultifrontalBayesNet(ordering)
        root, _ = net.matrix()
        inverse = np.linalg.inv(root)
        self._covariance = inverse @ inverse.T
        order = [net.at(index).keys()[0] for index in range(net.size())]  # each eliminated one pose
        self._first = {number: 3 * index for index, number in enumerate(order)}

    def between(self, a: int, b: int) -> np.ndarray:
        """(3, 3) covariance of the poses of two keyframes with each other."""
        i, j = self._first[a], self._first[b]
        return self._covariance[i : i + 3, j : j + 3]


def _part(edge: Edge) -> _Part:
    noise = gtsam.noiseModel.Gaussian.Covariance(_solvable(edge.covariance))
    return _Part(edge, gtsam.BetweenFactorPose2(edge.start, edge.end, gtsam.Pose2(*edge.motion), noise))


def _solvable(covariance: np.ndarray) -> np.ndarray:
    """A covariance within the range in which the graph can be solved."""
    shrink = np.minimum(1.0, VAGUEST_SIGMA / np.sqrt(np.diag(covariance)))
    return np.outer(shrink, shrink) * covariance + np.diag(FINEST_SIGMA**2)


def _chained(before: Edge, after: Edge) -> Edge:
    motion = planar.compose(before.motion, after.motion)
    covariance = carried(before.covariance, after.motion, after.covariance)
    return Edge(before.start, after.end, motion, covariance, before.is_loop)


def _bend(part: _Part, values: gtsam.Values) -> float:
    """Squared Mahalanobis distance of an edge from a solution."""
    return 2.0 * float(part.factor.error(values))
