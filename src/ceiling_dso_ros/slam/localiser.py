# SPDX-License-Identifier: BSD-3-Clause
"""Finds a robot in a map, and keeps it there.

While the robot is not localised, every keyframe is compared with the keyframes that look alike. Each sighting is a
hypothesis of the place. Hypotheses are followed along the way by the odometry, gain support from sightings that
agree with them, and lose it where the map should be seen again and is not. One is believed when it has support from
several keyframes along the way and no other one comes close.
"""

import enum
from dataclasses import dataclass, field
from typing import List, Optional, Set, Tuple

import numpy as np

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.slam.deciding import GATE, Gate, Place, Sighting, carried, distance
from ceiling_dso_ros.slam.records import KeyframeRecord
from ceiling_dso_ros.slam.site_map import Appearance, SiteMap, nearest_places
from ceiling_dso_ros.slam.verification import Verified, Verifier
from ceiling_dso_ros.slam.way import Step, Way

CANDIDATES = 5
NEAR_M = 1.5
NEAR_CANDIDATES = 2
SUPPORT = 4  # keyframes
SUPPORT_WAY_M = 1.0
RIVAL_SHARE = 1.0 / 3.0  # of the best one's support, from which on another hypothesis is alive
CLOSE_M, CLOSE_RAD = 0.3, 0.05  # of hypotheses that are one
EXPECTED_M = 0.8  # a keyframe of the map so near should be seen
MOST_MISSES = 6  # in a row, after which a localised robot is lost
LOST_SIGMA_M = 0.5
NAMED_SUPPORT = 2  # keyframes that must agree with a place that somebody has named
MOST_HYPOTHESES = 50
MOST_SIGHTINGS = 100  # of one hypothesis


class Localisation(enum.Enum):
    """State of the localiser."""

    SEARCHING = "searching"
    AMBIGUOUS = "ambiguous"  # several places look alike: driving on may tell
    LOCALISED = "localised"


@dataclass
class Hypothesis:
    """Where the robot may be.

    Attributes:
        pose: (3,) of base_link in map at the newest keyframe.
        covariance: (3, 3) of it.
        support: numbers of the keyframes that agree.
        first_m: way at the first of them.
        misses: keyframes that should have seen the map and did not.
        sightings: the newest of those that agree.
        is_named: somebody has said that the robot is here.
    """

    pose: np.ndarray
    covariance: np.ndarray
    first_m: float
    support: Set[int] = field(default_factory=set)
    misses: int = 0
    sightings: List[Sighting] = field(default_factory=list)
    is_named: bool = False

    @property
    def score(self) -> int:
        """Support without misses."""
        return len(self.support) - self.misses

    def follow(self, step: Step) -> None:
        """Move with the odometry."""
        self.pose = planar.compose(self.pose, step.motion)
        self.covariance = carried(self.covariance, step.motion, step.covariance)

    def correct(self, pose: np.ndarray, covariance: np.ndarray) -> None:
        """Take in a measured pose."""
        gain = self.covariance @ np.linalg.inv(self.covariance + covariance)
        self.pose = planar.compose(self.pose, gain @ planar.between(self.pose, pose))
        self.covariance = (np.eye(3) - gain) @ self.covariance
        self.covariance = 0.5 * (self.covariance + self.covariance.T)


class Localiser:
    """Localises the keyframes of one session in a map that does not change.

    Attributes:
        state: after the last keyframe.
        hypotheses: the places that are possible, the best first; one while localised.
        last: the last keyframe that was used.
        refusal: why the last comparison with it was refused, in words; empty if it was not.
        site: the map.
        way: of the session.
    """

    def __init__(self, site: SiteMap, verifier: Optional[Verifier] = None) -> None:
        self.site = site
        self._poses = site.poses
        self._records = [keyframe.record for keyframe in site.keyframes]
        self._appearance = Appearance(self._records)
        self._verifier = Verifier(site.camera) if verifier is None else verifier
        self.way = Way()
        self._misses = 0
        self.state = Localisation.SEARCHING
        self.hypotheses: List[Hypothesis] = []
        self.last: Optional[Step] = None
        self.refusal = ""

    @property
    def pose(self) -> Optional[np.ndarray]:
        """(3,) of base_link in map at the last keyframe; None unless localised."""
        return self.hypotheses[0].pose if self.state is Localisation.LOCALISED else None

    @property
    def T_map_odom(self) -> Optional[np.ndarray]:
        """(3,) of odom in map; None unless localised."""
        if self.pose is None or self.last is None:
            return None
        return planar.compose(self.pose, planar.inverse(self.last.record.pose))

    @property
    def place(self) -> Optional[Place]:
        """The pose with its covariance; None unless localised."""
        best = self.hypotheses[0] if self.state is Localisation.LOCALISED else None
        return None if best is None else Place(best.pose, best.covariance)

    def believe(self, place: Place) -> None:
        """Look for the robot near a place that somebody has named, at the last keyframe: fewer keyframes must agree."""
        way_m = 0.0 if self.last is None else self.last.way_m
        self.state, self._misses = Localisation.SEARCHING, 0
        self.hypotheses = [Hypothesis(place.pose, place.covariance, way_m, is_named=True)]

    def forget(self) -> None:
        """Look for the robot everywhere."""
        self.state, self.hypotheses, self._misses = Localisation.SEARCHING, [], 0

    def add(self, record: KeyframeRecord) -> Localisation:
        """Use a keyframe; those of one session must come in their order."""
        step = self.way.add(record)
        if step is None:
            return self.state
        self.last = step
        for hypothesis in self.hypotheses:
            hypothesis.follow(step)
        if self.state is Localisation.LOCALISED:
            self._track(step)
        else:
            self._search(step)
        return self.state

    def _track(self, step: Step) -> None:
        believed = self.hypotheses[0]
        near = nearest_places(self._poses, believed.pose, NEAR_M, NEAR_CANDIDATES)
        gates = {
            target: Gate(planar.between(self._poses[target], believed.pose), believed.covariance) for target in near
        }
        compared = [self._compare(step, target, gate) for target, gate in gates.items()]
        sightings = [seen for seen in compared if seen is not None]
        fitting = [seen for seen in sightings if not gates[seen.target].why_not(seen)]
        for seen in fitting:
            believed.correct(*self._placed(seen))
        if fitting:
            self._misses = 0
        elif sightings or nearest_places(self._poses, believed.pose, EXPECTED_M, 1):
            self._misses += 1
        sigma_m = np.sqrt(np.linalg.eigvalsh(believed.covariance[:2, :2])[1])
        if self._misses >= MOST_MISSES or sigma_m > LOST_SIGMA_M:
            self.forget()

    def _search(self, step: Step) -> None:
        targets = self._appearance.alike(step.record, CANDIDATES)
        for hypothesis in self.hypotheses[:CANDIDATES]:
            targets += nearest_places(self._poses, hypothesis.pose, NEAR_M, 1)
        sightings = [self._compare(step, target) for target in dict.fromkeys(targets)]
        for seen in sightings:
            if seen is not None:
                self._support(step, seen)
        for hypothesis in self.hypotheses:
            if step.number in hypothesis.support:
                continue
            if nearest_places(self._poses, hypothesis.pose, EXPECTED_M, 1):
                hypothesis.misses += 1
        self._merge()
        self._decide(step)

    def _support(self, step: Step, seen: Sighting) -> None:
        """Let a sighting support the hypotheses that it agrees with; without any it is a new one.

        Each motion that explains the views as well is a hypothesis of its own.
        """
        pose, covariance = self._placed(seen)
        target_pose = self._poses[seen.target]
        others = [planar.compose(target_pose, other) for other in seen.others[:1]]
        for place in (pose, *others):
            agreeing = [
                hypothesis
                for hypothesis in self.hypotheses
                if distance(hypothesis.pose, hypothesis.covariance + covariance, place) < GATE
                and (_close(hypothesis.pose, place) or (hypothesis.is_named and not hypothesis.support))
            ]
            for hypothesis in agreeing:
                if step.number not in hypothesis.support:
                    hypothesis.correct(place, covariance)
                hypothesis.support.add(step.number)
                hypothesis.sightings = [*hypothesis.sightings[1 - MOST_SIGHTINGS :], seen]
            if not agreeing:
                self.hypotheses.append(Hypothesis(place, covariance, step.way_m, {step.number}, 0, [seen]))

    def _merge(self) -> None:
        self.hypotheses.sort(key=lambda hypothesis: -hypothesis.score)
        kept: List[Hypothesis] = []
        for hypothesis in self.hypotheses:
            if hypothesis.score > -2 and not any(_close(other.pose, hypothesis.pose) for other in kept):
                kept.append(hypothesis)
        self.hypotheses = kept[:MOST_HYPOTHESES]

    def _decide(self, step: Step) -> None:
        self.state = Localisation.SEARCHING
        if not self.hypotheses:
            return
        best = self.hypotheses[0]
        clear = [
            number for number in best.support if any(s.query == number and not len(s.others) for s in best.sightings)
        ]
        enough = best.score >= SUPPORT and len(clear) >= SUPPORT // 2 and step.way_m - best.first_m >= SUPPORT_WAY_M
        enough = enough or (best.is_named and best.score >= NAMED_SUPPORT and len(clear) >= NAMED_SUPPORT)
        rivals = [other for other in self.hypotheses[1:] if len(other.support) > RIVAL_SHARE * len(best.support)]
        if enough and not rivals:
            self.state, self.hypotheses, self._misses = Localisation.LOCALISED, [best], 0
        elif len(self.hypotheses) > 1 and best.score > 1:
            self.state = Localisation.AMBIGUOUS

    def _compare(self, step: Step, target: int, gate: Optional[Gate] = None) -> Optional[Sighting]:
        found = self._verifier.verify(self._records[target], step.record, gate)
        self.refusal = "" if isinstance(found, Verified) else found.reason
        if not isinstance(found, Verified):
            return None
        return Sighting(step.number, target, found.motion, found.covariance, found.others)

    def _placed(self, seen: Sighting) -> Tuple[np.ndarray, np.ndarray]:
        return planar.compose(self._poses[seen.target], seen.motion), seen.covariance


def _close(a: np.ndarray, b: np.ndarray) -> bool:
    error = planar.between(a, b)
    return bool(np.hypot(*error[:2]) < CLOSE_M and abs(error[2]) < CLOSE_RAD)
