# SPDX-License-Identifier: BSD-3-Clause
"""A map of a simulated hall against the truth: wrong loops, recall of revisits, and how soon a robot is found."""

from dataclasses import dataclass, field
from typing import Dict, List, Optional, Sequence

import numpy as np

from ceiling_dso_ros.experiments.rendered_keyframes import RenderedKeyframes
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.slam.builder import RECENT_WAY_M, Decision, SiteBuilder
from ceiling_dso_ros.slam.localiser import Localiser
from ceiling_dso_ros.slam.records import KeyframeRecord
from ceiling_dso_ros.slam.site_map import SiteMap

WRONG_M, WRONG_RAD = 0.10, np.radians(1.0)
NEAR_M, FAR_M = 1.0, 2.0


def is_wrong(error: np.ndarray) -> bool:
    """Whether a (3,) error of a pose or motion is one that the map must never make."""
    return bool(np.hypot(*error[:2]) > WRONG_M or abs(error[2]) > WRONG_RAD)


@dataclass
class Counts:
    """What was counted; counts of several halls can be added.

    Attributes:
        loops: accepted.
        wrong_loops: of them with an error above the limit.
        comparisons: of pairs of keyframes.
        near, far: keyframes whose nearest earlier place is closer than 1 m, or 1 to 2 m.
        near_seen, far_seen: of them with an accepted loop.
        starts: places where a robot was switched on.
        found_m: way driven until it was found, of those that were.
        wrong_places: keyframes with a wrong pose while the robot was taken as found.
        placed: keyframes with a pose.
    """

    loops: int = 0
    wrong_loops: int = 0
    comparisons: int = 0
    near: int = 0
    near_seen: int = 0
    far: int = 0
    far_seen: int = 0
    starts: int = 0
    found_m: List[float] = field(default_factory=list)
    wrong_places: int = 0
    placed: int = 0

    def __add__(self, other: "Counts") -> "Counts":
        return Counts(*(getattr(self, name) + getattr(other, name) for name in vars(self)))


class MappedHall:
    """A map built of the keyframes of one drive.

    Attributes:
        site: the map.
        counts: of the loops.
        errors_m: of the kept keyframes, where the map begins at the true first pose.
    """

    def __init__(self, keyframes: RenderedKeyframes) -> None:
        self._truth: Dict[int, np.ndarray] = dict(zip(keyframes.stamps_ns.tolist(), keyframes.true_poses))
        records = keyframes.records()
        builder = SiteBuilder(keyframes.camera)
        decisions = [decision for record in records for decision in builder.add(record)]
        self.site: SiteMap = builder.site()
        self.counts = self._count_loops(records, decisions)
        self.errors_m = [float(np.hypot(*error[:2])) for error in self._errors()]

    def start_from(self, keyframes: RenderedKeyframes, first: int, most_m: float) -> Counts:
        """Switch a robot on at a keyframe of another drive and let it drive on."""
        counts = Counts(starts=1)
        localiser = Localiser(self.site)
        found_m: Optional[float] = None
        for index, record in enumerate(keyframes.records()[first:], first):
            localiser.add(record)
            way_m = 0.0 if localiser.last is None else localiser.last.way_m
            if localiser.pose is not None:
                found_m = way_m if found_m is None else found_m
                counts.placed += 1
                true = planar.between(self._origin, keyframes.true_poses[index])
                counts.wrong_places += is_wrong(planar.between(true, localiser.pose))
            if way_m > most_m:
                break
        counts.found_m = [] if found_m is None else [found_m]
        return counts

    @property
    def _origin(self) -> np.ndarray:
        """True pose of the map's origin."""
        first = self.site.keyframes[0]
        return planar.compose(self._truth[first.record.stamp_ns], planar.inverse(first.pose))

    def _errors(self) -> List[np.ndarray]:
        return [
            planar.between(planar.between(self._origin, self._truth[keyframe.record.stamp_ns]), keyframe.pose)
            for keyframe in self.site.keyframes
        ]

    def _count_loops(self, records: Sequence[KeyframeRecord], decisions: Sequence[Decision]) -> Counts:
        counts = Counts(comparisons=len(decisions))
        seen = set()
        for decision in decisions:
            if decision.accepted and decision.motion is not None:
                truth = planar.between(self._truth[decision.target_ns], self._truth[decision.query_ns])
                counts.loops += 1
                counts.wrong_loops += is_wrong(planar.between(truth, decision.motion))
                seen.add(decision.query_ns)
        true = np.array([self._truth[record.stamp_ns] for record in records])
        way_m = np.append(0.0, np.cumsum(np.hypot(*np.diff(true[:, :2], axis=0).T)))
        for index, record in enumerate(records):
            earlier = true[: np.searchsorted(way_m, way_m[index] - RECENT_WAY_M)]
            if not len(earlier):
                continue
            nearest_m = np.hypot(*(earlier[:, :2] - true[index, :2]).T).min()
            is_seen = record.stamp_ns in seen
            if nearest_m < NEAR_M:
                counts.near += 1
                counts.near_seen += is_seen
            elif nearest_m < FAR_M:
                counts.far += 1
                counts.far_seen += is_seen
        return counts
