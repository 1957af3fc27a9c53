# SPDX-License-Identifier: BSD-3-Clause
"""Which keyframes the map is made of: a few of each place, however often the robot comes back to it.

So the map, its normal equations and their time are bounded by the area and not by the length of the drive. The other
keyframes only tell where the scans around them are, before these are localised in the map.
"""

from dataclasses import dataclass
from typing import Dict, List, Optional, Sequence

import numpy as np

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.lidar.mapping.graph import Relation
from ceiling_dso_ros.lidar.scans.poses import between, compose, wrap

MOST_VIEWS = 2  # of one place in one direction: the neighbours' views of the same walls come to these


@dataclass(frozen=True)
class MapKeyframes:
    """All keyframes of a pass, and those of them that the map is made of.

    Attributes:
        scans: (K,) int, of all keyframes in the order of the pass.
        poses: (K, 3) of them.
        chosen: (M,) int, numbers of those that the map is made of, increasing.
        hosts: (K,) int, for each keyframe which of the chosen ones is at the same place; of a chosen one, itself.
    """

    scans: np.ndarray
    poses: np.ndarray
    chosen: np.ndarray
    hosts: np.ndarray

    @staticmethod
    def choose(scans: np.ndarray, poses: np.ndarray, near_m: float, near_rad: float) -> "MapKeyframes":
        """Choose, where near_m and near_rad say what is one place in one direction."""
        chosen: List[int] = []
        hosts = np.zeros(len(poses), int)
        kept = np.empty_like(poses)
        for number, pose in enumerate(poses):
            others = kept[: len(chosen)]
            away_m = np.hypot(others[:, 0] - pose[0], others[:, 1] - pose[1])
            near = np.flatnonzero((away_m < near_m) & (np.abs(wrap(others[:, 2] - pose[2])) < near_rad))
            if len(near) < MOST_VIEWS:
                kept[len(chosen)] = pose
                hosts[number] = len(chosen)
                chosen.append(number)
            else:
                hosts[number] = near[np.argmin(away_m[near])]
        return MapKeyframes(scans, poses, np.array(chosen, int), hosts)

    @property
    def map_scans(self) -> np.ndarray:
        """(M,) int, scans of the chosen ones."""
        return self.scans[self.chosen]

    @property
    def map_poses(self) -> np.ndarray:
        """(M, 3) of the chosen ones."""
        return self.poses[self.chosen]

    def backwards(self) -> "MapKeyframes":
        """The same keyframes in the opposite order."""
        last, last_chosen = len(self.scans) - 1, len(self.chosen) - 1
        return MapKeyframes(
            self.scans[::-1], self.poses[::-1], last - self.chosen[::-1], (last_chosen - self.hosts)[::-1]
        )

    def carried(self, map_poses: np.ndarray) -> np.ndarray:
        """(K, 3) poses of all keyframes where the chosen ones have poses (M, 3): each moves with its host."""
        seen = between(self.map_poses[self.hosts], self.poses)
        return compose(map_poses[self.hosts], seen)

    def relations(self, chain: Sequence[Relation], loops: Sequence[Relation]) -> List[Relation]:
        """Relations between the chosen ones, by their numbers in the map.

        Args:
            chain: from keyframe to next keyframe; those on the way from one chosen one to the next are composed.
            loops: are kept where both keyframes are chosen ones.
        """
        number = {keyframe: index for index, keyframe in enumerate(self.chosen.tolist())}
        steps = {relation.first: relation for relation in chain}
        composed = (_composed(steps, first, second) for first, second in zip(self.chosen[:-1], self.chosen[1:]))
        kept = [each for each in composed if each is not None]
        kept += [each for each in loops if each.first in number and each.second in number]
        return [Relation(number[each.first], number[each.second], each.moved, each.covariance) for each in kept]


def _composed(steps: Dict[int, Relation], first: int, second: int) -> Optional[Relation]:
    """The relation of two keyframes by all steps between them; None where one is missing."""
    relation: Optional[Relation] = None
    for keyframe in range(first, second):
        step = steps.get(keyframe)
        if step is None:
            return None
        if relation is None:
            relation = step
            continue
        back = planar.adjoint(planar.inverse(step.moved))
        moved = planar.compose(relation.moved, step.moved)
        relation = Relation(first, step.second, moved, back @ relation.covariance @ back.T + step.covariance)
    return relation
