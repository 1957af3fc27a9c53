# SPDX-License-Identifier: BSD-3-Clause
"""Maps of sites from recordings, and recordings in such maps."""

from dataclasses import dataclass
from pathlib import Path
from typing import List, Optional, Sequence, Tuple

import numpy as np

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.trajectory import Trajectory
from ceiling_dso_ros.playback.fused_record import planar_trajectory
from ceiling_dso_ros.playback.fusion_playback import FusionPlayback
from ceiling_dso_ros.playback.playback import Playback
from ceiling_dso_ros.slam.builder import Decision, SiteBuilder
from ceiling_dso_ros.slam.localiser import Localisation
from ceiling_dso_ros.slam.record_maker import NewRecord
from ceiling_dso_ros.slam.records import RecordCamera, handed_over
from ceiling_dso_ros.slam.session import MapSession
from ceiling_dso_ros.slam.site_map import SiteMap


@dataclass(frozen=True)
class MappedDrive:
    """What a map needs of a drive.

    Attributes:
        camera: of the records.
        records: of the keyframes, as they left the window, in their order.
        fused: base_link in odom, on the wheels' clock.
    """

    camera: RecordCamera
    records: Sequence[NewRecord]
    fused: Trajectory

    @classmethod
    def of(cls, playback: Playback, fusion: FusionPlayback, path: Path) -> "MappedDrive":
        """Of a run that is over and has kept its keyframes.

        Raises:
            InputError: it has no keyframes whose metric pose is known.
        """
        if not playback.records:
            raise InputError(f"{path}: gives no map: the scale of its images never became known")
        camera = RecordCamera.of(handed_over(playback.visual.preprocess.camera), fusion.estimator.robot.T_base_camera)
        return cls(camera, playback.records, fusion.fused())


@dataclass(frozen=True)
class DriveInMap:
    """A drive that was looked for in a map.

    Attributes:
        states: after each record.
        keyframes: stamp on the wheels' clock and (3,) pose in map while the robot was localised, at the newest keyframe
            when one that had left was found.
        first_m: way driven until it was localised first; None if it never was.
    """

    states: Sequence[Localisation]
    keyframes: Sequence[Tuple[int, np.ndarray]]
    first_m: Optional[float]

    def trajectory(self, fused: Trajectory) -> Trajectory:
        """base_link in map at the stamps of the fused trajectory at which it is known.

        Args:
            fused: base_link in odom. It continues each keyframe's pose in map until the next one.
        """
        stamps_ns = fused.stamps_ns
        T = fused.matrices()
        odom = np.column_stack([T[:, :2, 3], np.arctan2(T[:, 1, 0], T[:, 0, 0])])
        known: List[Tuple[int, np.ndarray]] = []
        ends = [stamp_ns for stamp_ns, _ in self.keyframes[1:]] + [int(stamps_ns[-1]) + 1]
        for (start_ns, pose), end_ns in zip(self.keyframes, ends):
            inside = np.flatnonzero((stamps_ns >= start_ns) & (stamps_ns < end_ns))
            for index in inside:
                known.append(
                    (int(stamps_ns[index]), planar.compose(pose, planar.between(odom[inside[0]], odom[index])))
                )
        return planar_trajectory([stamp_ns for stamp_ns, _ in known], [pose for _, pose in known])


def localise(site: SiteMap, drive: MappedDrive) -> DriveInMap:
    """Look for a drive in a map, keyframe by keyframe, without later information."""
    session = MapSession(site.camera, site, mapping=False)
    states, keyframes = [], []
    first_m = None
    for new in drive.records:
        found = session.add(new)
        states.append(found.state)
        if found.place is not None:
            keyframes.append((new.newest_ns, found.place.pose))
            first_m = found.way_m if first_m is None else first_m
    return DriveInMap(states, keyframes, first_m)


def build(builder: SiteBuilder, drive: MappedDrive) -> List[Decision]:
    """Add a drive to a map as a session of its own; returns what became of the comparisons."""
    decisions: List[Decision] = []
    for index, new in enumerate(drive.records):
        if new.begins and index:
            builder.begin_session()
        decisions += builder.add(new.record)
    return decisions
