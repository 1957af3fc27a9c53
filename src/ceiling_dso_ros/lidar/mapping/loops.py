# SPDX-License-Identifier: BSD-3-Clause
"""Places that the robot came back to: keyframes that match a submap of another time.

All pairs of submaps are looked at that may overlap, as far as the way between them leaves that open.
"""

from typing import Callable, List, Optional, Set, Tuple

import numpy as np

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.lidar.config import LidarConfig
from ceiling_dso_ros.lidar.mapping.graph import Relation
from ceiling_dso_ros.lidar.matching.likelihood_field import LikelihoodField
from ceiling_dso_ros.lidar.scans.poses import between, transformed

DRIFT, DRIFT_RAD_M = 0.02, 0.004  # of the way that was driven meanwhile, and turned for each metre of it
REACH_M, REACH_RAD = (0.5, 6.0), (0.2, 1.2)  # of a search: without a way between, and at most
LEAST_SCORE, LEAST_FIT = 0.5, 0.5
DISTINCT_SCORE = 0.93  # of the best place's that another one may have
NOISE_FACTOR = 2.0
LEAST_SIGMAS = np.array([0.01, 0.01, 0.003])  # of the shape of a submap
NO_PRIOR = np.eye(3) * 1e-6


class LoopFinder:
    """Looks for loops among the keyframes; each pair of places is connected once."""

    def __init__(
        self,
        points: Callable[[int], np.ndarray],
        dense: Callable[[int], np.ndarray],
        way_m: np.ndarray,
        radius_m: float,
        config: LidarConfig,
    ) -> None:
        """Begin.

        Args:
            points: makes those of a keyframe, (n, 2), seen from itself; they are not kept.
            dense: the same with more points, of which the submaps are made.
            way_m: (K,) driven up to each keyframe.
            radius_m: of a submap.
            config: settings.
        """
        self._points, self._dense = points, dense
        self._way_m, self._radius_m, self._config = way_m, radius_m, config
        self._length = config.submap_keyframes
        self._connected: Set[Tuple[int, int]] = set()  # group of keyframes, group of keyframes

    def find(self, poses: np.ndarray) -> List[Relation]:
        """New loops, where the keyframes have poses (K, 3)."""
        loops: List[Relation] = []
        half = self._length // 2
        groups = [np.arange(first, min(first + half, len(poses))) for first in range(0, len(poses), half)]
        for number, group in enumerate(groups):
            wanted = [other for other in range(number + 3, len(groups)) if (number, other) not in self._connected]
            centre = int(group[len(group) // 2])
            candidates = [(other, self._nearest(poses, centre, groups[other])) for other in wanted]
            candidates = [
                (other, keyframe) for other, keyframe in candidates if self._may_meet(poses, centre, keyframe)
            ]
            if not candidates:
                continue
            field = self._field(poses, centre)
            for other, keyframe in candidates:
                loop = self._match(field, poses, centre, keyframe)
                if loop is not None:
                    loops.append(loop)
                    self._connected.add((number, other))
        return loops

    def _nearest(self, poses: np.ndarray, centre: int, group: np.ndarray) -> int:
        """The keyframe of a group that sees most of what a place sees: near, and turned alike."""
        moved = between(poses[centre][None], poses[group])
        return int(group[np.argmin(np.hypot(moved[:, 0], moved[:, 1]) + np.abs(moved[:, 2]))])

    def _drift_m(self, first: int, second: int) -> float:
        return DRIFT * abs(float(self._way_m[second] - self._way_m[first]))

    def _may_meet(self, poses: np.ndarray, first: int, second: int) -> bool:
        away_m = float(np.hypot(*(poses[second, :2] - poses[first, :2])))
        return away_m < 0.5 * self._radius_m + self._drift_m(first, second)

    def _field(self, poses: np.ndarray, centre: int) -> LikelihoodField:
        """The submap around a keyframe, of those before and after it."""
        field = LikelihoodField(self._radius_m, self._config)
        half = self._length // 2
        for keyframe in range(max(0, centre - half), min(len(poses), centre + half + 1)):
            field.add(transformed(self._dense(keyframe), planar.between(poses[centre], poses[keyframe])))
        return field

    def _match(self, field: LikelihoodField, poses: np.ndarray, centre: int, keyframe: int) -> Optional[Relation]:
        points = self._points(keyframe)
        guess = planar.between(poses[centre], poses[keyframe])
        way_m = abs(float(self._way_m[keyframe] - self._way_m[centre]))
        reach_m = min(REACH_M[0] + DRIFT * way_m, REACH_M[1])
        reach_rad = min(REACH_RAD[0] + DRIFT_RAD_M * way_m, REACH_RAD[1])
        place = field.search(points, guess, reach_m, reach_rad, LEAST_SCORE)
        if place is None:
            return None
        if field.search(points, guess, reach_m, reach_rad, DISTINCT_SCORE * place.score, place.pose) is not None:
            return None  # a corridor, or two places that look alike
        match = field.align(points, place.pose, place.pose, NO_PRIOR)
        if match.fit < LEAST_FIT:
            return None
        turned = np.eye(3)
        turned[:2, :2] = planar.rotation(match.pose[2])
        information = turned.T @ match.information @ turned / NOISE_FACTOR**2 + NO_PRIOR
        covariance = np.linalg.inv(information) + np.diag(LEAST_SIGMAS**2)
        return Relation(centre, keyframe, match.pose, covariance)
