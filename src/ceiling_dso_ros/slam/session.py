# SPDX-License-Identifier: BSD-3-Clause
"""One robot in one map, keyframe by keyframe: it is mapped or localised, and each keyframe gives a report."""

from dataclasses import dataclass
from typing import Optional, Union

import numpy as np

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.slam.builder import SiteBuilder
from ceiling_dso_ros.slam.deciding import Place, carried, walked
from ceiling_dso_ros.slam.localiser import Localisation, Localiser
from ceiling_dso_ros.slam.record_maker import NewRecord
from ceiling_dso_ros.slam.records import KeyframeRecord, RecordCamera
from ceiling_dso_ros.slam.site_map import SiteMap


@dataclass(frozen=True)
class Situation:
    """What is known after a keyframe.

    Attributes:
        state: of the localisation; a robot whose drive is part of the map that is built is LOCALISED.
        place: of base_link in map at the newest keyframe of the odometry; None unless localised by this keyframe.
        way_m: driven since the session began.
        hypotheses: (N, 3) poses in map that are possible, the best first; none once the drive is part of the map.
        quality: 0 to 1: share of the support that the best hypothesis has, among all; 1 when localised.
        reason: why the last comparison was refused, in words; empty if it was not, or there was none.
    """

    state: Localisation
    place: Optional[Place]
    way_m: float
    hypotheses: np.ndarray
    quality: float
    reason: str


class MapSession:
    """A robot in a map.

    Attributes:
        camera: of the records.
        is_mapping: keyframes become part of the map.
    """

    def __init__(self, camera: RecordCamera, site: Optional[SiteMap] = None, mapping: bool = True) -> None:
        """Begin.

        Args:
            camera: of the records.
            site: what is known of the site; None to begin a map.
            mapping: build the map; else it does not change.
        """
        self.camera, self.is_mapping = camera, mapping
        self._engine = self._begin(SiteMap(camera, (), ()) if site is None else site)
        self._place: Optional[Place] = None  # at the last keyframe

    @property
    def site(self) -> SiteMap:
        """The map so far."""
        return self._engine.site if isinstance(self._engine, Localiser) else self._engine.site()

    def set_mapping(self, mapping: bool) -> None:
        """Go on with or without building the map, near where the robot is."""
        if mapping == self.is_mapping:
            return
        place, self.is_mapping = self._place, mapping
        self._engine = self._begin(self.site)
        if place is not None:
            self.believe(place)

    def search(self) -> None:
        """Forget where the robot is."""
        self._place = None
        if isinstance(self._engine, Localiser):
            self._engine.forget()
        else:
            self._engine.begin_session()

    def believe(self, place: Place) -> None:
        """Look for the robot near a place in the map."""
        self._engine.believe(place)

    def add(self, new: NewRecord) -> Situation:
        """Use a keyframe; those of one drive must come in their order."""
        if new.begins and self._engine.last is not None:
            self._engine = self._begin(self.site)
        before = self._engine.last
        refusal = self._use(new.record)
        used = self._engine.last is not before
        if used:
            self._place = self._engine.place
        last, hypotheses = self._engine.last, self._engine.hypotheses
        support = [len(hypothesis.support) for hypothesis in hypotheses]
        return Situation(
            self._engine.state,
            _moved(self._place, new.to_newest) if used else None,
            0.0 if last is None else last.way_m,
            np.array([hypothesis.pose for hypothesis in hypotheses]).reshape(-1, 3),
            1.0 if self._place is not None else support[0] / max(sum(support), 1) if support else 0.0,
            refusal,
        )

    def _begin(self, site: SiteMap) -> Union[SiteBuilder, Localiser]:
        return SiteBuilder(self.camera, site) if self.is_mapping else Localiser(site)

    def _use(self, record: KeyframeRecord) -> str:
        """Use a keyframe; returns why the last comparison was refused."""
        if isinstance(self._engine, Localiser):
            self._engine.add(record)
            return self._engine.refusal
        refused = [decision.reason for decision in self._engine.add(record) if not decision.accepted]
        return refused[-1] if refused else ""


def _moved(place: Optional[Place], motion: np.ndarray) -> Optional[Place]:
    """A place after a motion by the odometry."""
    if place is None:
        return None
    covariance = carried(place.covariance, motion, walked(motion))
    return Place(planar.compose(place.pose, motion), covariance)
