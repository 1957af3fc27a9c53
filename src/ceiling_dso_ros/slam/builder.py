# SPDX-License-Identifier: BSD-3-Clause
"""Builds a map from the keyframes of one or several sessions.

The first session begins the map. Each further one is joined when it is localised in what there is so far. A keyframe
that sees a known place again closes a loop, once several keyframes along the way agree. A keyframe whose place the map
shows already, under the same light, is let go later: the map grows with the area, not with the time driven.
"""

from typing import Dict, List, NamedTuple, Optional, Tuple

import numpy as np

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.slam.deciding import Gate, Sighting, agreeing, carried
from ceiling_dso_ros.slam.graph import PoseGraph
from ceiling_dso_ros.slam.localiser import Localisation, Localiser
from ceiling_dso_ros.slam.records import KeyframeRecord, RecordCamera
from ceiling_dso_ros.slam.site_map import Edge, MapKeyframe, SiteMap, nearest_places
from ceiling_dso_ros.slam.verification import Verified, Verifier
from ceiling_dso_ros.slam.way import Step, Way

AGREEMENT = 3  # keyframes that must tell of the same correction
RECENT_STEPS = 8
RECENT_WAY_M = 5.0  # an earlier keyframe of the same drive is a loop only after such a way
REACH_M = 2.0
CANDIDATES = 4
COVERED_M, COVERED_RAD = 0.5, 0.8
SAME_LIGHT = 25.0  # grey levels of the mean


class Decision(NamedTuple):
    """What became of a comparison, for those who ask why a loop was closed.

    Attributes:
        query_ns, target_ns: stamps of the keyframes.
        accepted: whether it is a loop now.
        reason: why not, in words.
        motion: (3,) T_target_query; None if the views do not show the same place.
    """

    query_ns: int
    target_ns: int
    accepted: bool
    reason: str
    motion: Optional[np.ndarray]


class SiteBuilder:
    """Builds a map.

    Attributes:
        graph: poses of the keyframes that are kept.
        decisions: of all comparisons so far.
    """

    def __init__(self, camera: RecordCamera) -> None:
        self._camera = camera
        self._verifier = Verifier(camera)
        self.graph = PoseGraph()
        self.decisions: List[Decision] = []
        self._records: Dict[int, Tuple[KeyframeRecord, int]] = {}  # number -> record, session
        self._session = -1
        self._next = 0
        self.begin_session()

    def begin_session(self) -> None:
        """The next keyframe is the first of another drive."""
        self._session += 1
        self._way = Way()
        self._waiting: List[Sighting] = []  # seen, but not agreed upon yet
        self._steps: List[Tuple[int, Step]] = []  # number in the graph and step, since the session is in the map
        self._localiser: Optional[Localiser] = None
        self._unplaced: List[Step] = []
        self._covered: List[int] = []
        if self.graph.poses:
            self._localiser = Localiser(self.site(), self._verifier)

    @property
    def is_placed(self) -> bool:
        """Whether the current session is part of the map."""
        return self._localiser is None

    def add(self, record: KeyframeRecord) -> None:
        """Use a keyframe; those of one session must come in their order."""
        if self._localiser is not None:
            self._seek(record, self._localiser)
            return
        step = self._way.add(record)
        if step is None:
            return
        number = self._append(step)
        self._look_around(number, step)
        self._close_loops()
        self._let_go()

    def site(self) -> SiteMap:
        """The map so far."""
        numbers = sorted(self.graph.poses)
        index = {number: i for i, number in enumerate(numbers)}
        keyframes = []
        for number in numbers:
            record, session = self._records[number]
            keyframes.append(MapKeyframe(record, self.graph.poses[number], session))
        edges = [edge._replace(start=index[edge.start], end=index[edge.end]) for edge in self.graph.edges]
        return SiteMap(self._camera, tuple(keyframes), tuple(edges))

    def _append(self, step: Step) -> int:
        number = self._next
        self._next += 1
        self._records[number] = step.record, self._session
        if self._steps:
            before, _ = self._steps[-1]
            self.graph.poses[number] = planar.compose(self.graph.poses[before], step.motion)
            self.graph.edges.append(Edge(before, number, step.motion, step.covariance, False))
        elif not self.graph.poses:
            self.graph.poses[number] = step.record.pose.copy()
        self._steps.append((number, step))
        return number

    def _look_around(self, number: int, step: Step) -> None:
        """Compare a new keyframe with those that may show the same place."""
        driven = {n: s.way_m for n, s in self._steps}
        known = [n for n in self.graph.poses if n != number and step.way_m - driven.get(n, -np.inf) > RECENT_WAY_M]
        poses = np.array([self.graph.poses[n] for n in known]).reshape(-1, 3)
        near = [known[i] for i in nearest_places(poses, self.graph.poses[number], REACH_M, CANDIDATES)]
        if not near:
            return
        covariances = self.graph.covariances_from(number, near)
        for target in near:
            gate = Gate(self.graph.predicted(target, number), covariances[target])
            found = self._verifier.verify(self._records[target][0], step.record, gate.expected)
            if not isinstance(found, Verified):
                self._decide(number, target, found.reason, None)
                continue
            seen = Sighting(number, target, found.motion, found.covariance, found.others)
            reason = gate.why_not(seen)
            if reason:
                self._decide(number, target, reason, found.motion)
            else:
                self._waiting.append(seen)

    def _close_loops(self) -> None:
        """Turn sightings that agree into loops."""
        recent = {number for number, _ in self._steps[-RECENT_STEPS:]}
        late = [seen for seen in self._waiting if seen.query not in recent]
        self._settle(late, "too few keyframes agree")
        if not self._waiting or self._waiting[-1].query != self._steps[-1][0]:
            return
        estimates = [self._implied(seen) for seen in self._waiting]
        groups = agreeing(estimates)
        agreed = [[estimates[i][0] for i in group] for group in groups]
        if len(set(agreed[0])) < AGREEMENT:
            return
        if len(groups) > 1 and 2 * len(set(agreed[1])) >= len(set(agreed[0])):
            return  # two explanations are alive
        loops = [self._waiting[i] for i in groups[0]]
        reason = self.graph.close([Edge(s.target, s.query, s.motion, s.covariance, True) for s in loops])
        self._settle(loops, reason)

    def _settle(self, sightings: List[Sighting], reason: str) -> None:
        settled = [(seen.query, seen.target) for seen in sightings]
        self._waiting = [seen for seen in self._waiting if (seen.query, seen.target) not in settled]
        for seen in sightings:
            self._decide(seen.query, seen.target, reason, seen.motion)
            if not reason:
                self._note_covered(seen)

    def _decide(self, query: int, target: int, reason: str, motion: Optional[np.ndarray]) -> None:
        """Note what became of a comparison; without a reason against it, it is a loop."""
        stamps_ns = self._records[query][0].stamp_ns, self._records[target][0].stamp_ns
        self.decisions.append(Decision(*stamps_ns, not reason, reason, motion))

    def _implied(self, seen: Sighting) -> Tuple[int, np.ndarray, np.ndarray]:
        """Pose in map of the newest keyframe by a sighting of a recent one, with its covariance."""
        pose, covariance = planar.compose(self.graph.poses[seen.target], seen.motion), seen.covariance
        for number, step in self._steps:
            if number > seen.query:
                pose = planar.compose(pose, step.motion)
                covariance = carried(covariance, step.motion, step.covariance)
        return seen.query, pose, covariance

    def _note_covered(self, seen: Sighting) -> None:
        """Remember a keyframe that shows nothing new."""
        here, there = self._records[seen.query][0], self._records[seen.target][0]
        is_near = np.hypot(*seen.motion[:2]) < COVERED_M and abs(seen.motion[2]) < COVERED_RAD
        if is_near and abs(here.brightness - there.brightness) < SAME_LIGHT and seen.query not in self._covered:
            self._covered.append(seen.query)

    def _let_go(self) -> None:
        """Remove what shows nothing new and is not needed for decisions any more."""
        recent = {number for number, _ in self._steps[-RECENT_STEPS:]}
        for number in [n for n in self._covered if n not in recent]:
            self.graph.let_go(number)
            del self._records[number]
            self._covered.remove(number)
        self._steps = [entry for entry in self._steps if entry[0] in self.graph.poses]

    def _seek(self, record: KeyframeRecord, localiser: Localiser) -> None:
        """Wait until the session is localised; then all of its keyframes become part of the map."""
        before = localiser.last
        state = localiser.add(record)
        if localiser.last is before or localiser.last is None:
            return
        self._unplaced.append(localiser.last)
        if state is not Localisation.LOCALISED or localiser.T_map_odom is None:
            return
        numbers = sorted(self.graph.poses)
        origin = localiser.T_map_odom
        sightings = localiser.hypotheses[0].sightings
        first = self._next
        for step in self._unplaced:
            number = self._append(step)
            if len(self._steps) == 1:
                self.graph.poses[number] = planar.compose(origin, step.record.pose)
        loops = [
            Edge(numbers[s.target], first + s.query, s.motion, s.covariance, True)
            for s in sightings
            if not len(s.others)
        ]
        reason = self.graph.close(loops)
        if reason:  # as if the session had not been localised
            self._withdraw(first)
            return
        self._localiser = None
        self._way = localiser.way
        for edge in loops:
            self._decide(edge.end, edge.start, "", edge.motion)

    def _withdraw(self, first: int) -> None:
        self.graph.edges = [edge for edge in self.graph.edges if edge.end < first]
        for number in range(first, self._next):
            del self.graph.poses[number], self._records[number]
        self._next = first
        self._steps = []
        self._unplaced = []
        self._localiser = Localiser(self.site(), self._verifier)
