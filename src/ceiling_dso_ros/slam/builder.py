# SPDX-License-Identifier: BSD-3-Clause
"""Builds a map from the keyframes of one or several sessions.

The first session begins the map. Each further one is joined when it is localised in what there is so far. A keyframe
that sees a known place again closes a loop, once several keyframes along the way agree. A keyframe whose place the map
shows already, under the same light, is let go later, and so is one whose place has many views: the map grows with the
area, not with the time driven. A robot that should see known places and does not was carried away: its session ends.
"""

from typing import Dict, List, NamedTuple, Optional, Tuple

import numpy as np

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.slam.deciding import Gate, Place, Sighting, agreeing, carried
from ceiling_dso_ros.slam.graph import PoseGraph
from ceiling_dso_ros.slam.localiser import EXPECTED_M, MOST_MISSES, Hypothesis, Localisation, Localiser
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
MOST_VIEWS = 4  # of places within COVERED_M of each other, whatever their light
MOST_UNPLACED = 60  # newest keyframes of a session that is not localised yet; older ones never become part of the map


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
        camera: of all records.
        graph: poses of the keyframes that are kept.
    """

    def __init__(self, camera: RecordCamera, site: Optional[SiteMap] = None) -> None:
        """Begin a map, or continue one."""
        self.camera = camera
        self._verifier = Verifier(camera)
        self.graph = PoseGraph()
        self._decisions: List[Decision] = []  # since the last keyframe
        self._records: Dict[int, Tuple[KeyframeRecord, int]] = {}  # number -> record, session
        self._session = -1
        self._next = 0
        if site is not None:
            self._continue(site)
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
        self._misses: List[int] = []  # keyframes that should have seen the map and did not, since the last that did
        if self.graph.poses:
            self._localiser = Localiser(self.site(), self._verifier)

    @property
    def is_placed(self) -> bool:
        """Whether the current session is part of the map."""
        return self._localiser is None

    @property
    def state(self) -> Localisation:
        """Of the current session."""
        return Localisation.LOCALISED if self._localiser is None else self._localiser.state

    @property
    def hypotheses(self) -> List[Hypothesis]:
        """Places where a session that is not placed may be, the best first."""
        return [] if self._localiser is None else self._localiser.hypotheses

    @property
    def last(self) -> Optional[Step]:
        """The last keyframe of the session that was used."""
        if self._localiser is not None:
            return self._localiser.last
        return self._steps[-1][1] if self._steps else None

    @property
    def place(self) -> Optional[Place]:
        """Where the robot was at the last keyframe; None unless the session is placed."""
        if self._localiser is not None or not self._steps:
            return None
        number, _ = self._steps[-1]
        return Place(self.graph.poses[number], self.graph.covariance(number))

    def believe(self, place: Place) -> None:
        """Look for the robot near a place that somebody has named; see `Localiser.believe`."""
        if self.graph.poses:
            self.begin_session()
        if self._localiser is not None:
            self._localiser.believe(place)

    def add(self, record: KeyframeRecord) -> List[Decision]:
        """Use a keyframe; those of one session must come in their order.

        Returns:
            What became of comparisons, those with this keyframe and earlier ones that had to wait.
        """
        self._decisions = []
        if self._localiser is not None:
            self._seek(record, self._localiser)
            return self._decisions
        step = self._way.add(record)
        if step is None:
            return []
        number = self._append(step)
        self._look_around(number, step)
        self._close_loops()
        self._let_go()
        if len(self._misses) >= MOST_MISSES:
            self._carried_away()
        return self._decisions

    def site(self) -> SiteMap:
        """The map so far."""
        numbers = sorted(self.graph.poses)
        index = {number: i for i, number in enumerate(numbers)}
        keyframes = []
        for number in numbers:
            record, session = self._records[number]
            keyframes.append(MapKeyframe(record, self.graph.poses[number], session))
        edges = [edge._replace(start=index[edge.start], end=index[edge.end]) for edge in self.graph.edges]
        return SiteMap(self.camera, tuple(keyframes), tuple(edges))

    def _continue(self, site: SiteMap) -> None:
        for number, keyframe in enumerate(site.keyframes):
            self.graph.place(number, keyframe.pose)
            self._records[number] = keyframe.record, keyframe.session
        for edge in site.edges:
            self.graph.connect(edge)
        self._next = len(site.keyframes)
        self._session = max((keyframe.session for keyframe in site.keyframes), default=-1)

    def _append(self, step: Step) -> int:
        number = self._next
        self._next += 1
        self._records[number] = step.record, self._session
        if self._steps:
            before, _ = self._steps[-1]
            self.graph.place(number, planar.compose(self.graph.poses[before], step.motion))
            self.graph.connect(Edge(before, number, step.motion, step.covariance, False))
        elif number not in self.graph.poses:
            self.graph.place(number, step.record.pose)
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
            found = self._verifier.verify(self._records[target][0], step.record, gate)
            if not isinstance(found, Verified):
                self._decide(number, target, found.reason, None)
                continue
            seen = Sighting(number, target, found.motion, found.covariance, found.others)
            reason = gate.why_not(seen)
            if reason:
                self._decide(number, target, reason, found.motion)
            else:
                self._waiting.append(seen)
        if any(seen.query == number for seen in self._waiting):
            self._misses = []
        elif nearest_places(poses, self.graph.poses[number], EXPECTED_M, 1):
            self._misses.append(number)

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
        self._decisions.append(Decision(*stamps_ns, not reason, reason, motion))

    def _implied(self, seen: Sighting) -> Tuple[int, np.ndarray, np.ndarray]:
        """Pose in map of the newest keyframe by a sighting of a recent one, with its covariance."""
        pose, covariance = planar.compose(self.graph.poses[seen.target], seen.motion), seen.covariance
        for number, step in self._steps[-RECENT_STEPS:]:
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
        if len(self._steps) > RECENT_STEPS and self._is_crowded(self._steps[-RECENT_STEPS - 1][0]):
            self._covered.append(self._steps[-RECENT_STEPS - 1][0])
        needed = recent | {seen.target for seen in self._waiting}
        for number in dict.fromkeys(n for n in self._covered if n not in needed):
            self.graph.let_go(number)
            del self._records[number]
        self._covered = [number for number in self._covered if number in needed]
        self._steps = [entry for entry in self._steps if entry[0] in self.graph.poses]

    def _is_crowded(self, number: int) -> bool:
        """Whether there are enough views of a keyframe's place without it; the map's first one always stays."""
        poses = np.array(list(self.graph.poses.values()))
        near = nearest_places(poses, self.graph.poses[number], COVERED_M, MOST_VIEWS + 1)
        return number != min(self.graph.poses) and len(near) > MOST_VIEWS

    def _carried_away(self) -> None:
        """End the session where it last agreed with the map, and look for the robot."""
        first = self._misses[0]
        self._withdraw([number for number, _ in self._steps if number >= first])
        self.begin_session()

    def _seek(self, record: KeyframeRecord, localiser: Localiser) -> None:
        """Wait until the session is localised; then its newest keyframes become part of the map."""
        before = localiser.last
        state = localiser.add(record)
        if localiser.last is before or localiser.last is None:
            return
        self._unplaced = [*self._unplaced[1 - MOST_UNPLACED :], localiser.last]
        if state is not Localisation.LOCALISED or localiser.pose is None:
            return
        known = sorted(self.graph.poses)
        pose = localiser.pose
        for step in reversed(self._unplaced[1:]):
            pose = planar.compose(pose, planar.inverse(step.motion))
        self.graph.place(self._next, pose)
        own = {step.number: self._append(step) for step in self._unplaced}
        seen_again = [
            Sighting(own[s.query], known[s.target], s.motion, s.covariance, s.others)
            for s in localiser.hypotheses[0].sightings
            if not len(s.others) and s.query in own
        ]
        if self.graph.close([Edge(s.target, s.query, s.motion, s.covariance, True) for s in seen_again]):
            self._withdraw(list(own.values()))  # as if the session had not been localised
            self._steps, self._unplaced = [], []
            self._localiser = Localiser(self.site(), self._verifier)
            return
        self._localiser = None
        self._way = localiser.way
        self._settle(seen_again, "")

    def _withdraw(self, numbers: List[int]) -> None:
        """Remove the newest keyframes as if they had never come."""
        self.graph.remove(numbers)
        for number in numbers:
            del self._records[number]
