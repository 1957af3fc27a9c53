# SPDX-License-Identifier: BSD-3-Clause
"""The map of a site as a value: keyframes with their poses, and what connects them."""

from dataclasses import dataclass
from typing import List, NamedTuple, Sequence, Tuple

import numpy as np

from ceiling_dso_ros.slam.matching_kernels import vote
from ceiling_dso_ros.slam.records import KeyframeRecord, RecordCamera

VOTE_BITS = 56
TIE_BITS = 6
NO_DESCRIPTORS = np.zeros((0, 4), np.uint64)


class Edge(NamedTuple):
    """A measured motion between two keyframes.

    Attributes:
        start, end: numbers of the keyframes.
        motion: (3,) T_start_end of base_link.
        covariance: (3, 3) of it, as in `fusion.planar`.
        is_loop: found by comparing the keyframes; else by the odometry between them.
    """

    start: int
    end: int
    motion: np.ndarray
    covariance: np.ndarray
    is_loop: bool


@dataclass(frozen=True)
class MapKeyframe:
    """A keyframe of the map.

    Attributes:
        record: what it shows.
        pose: (3,) of base_link in map.
        session: the recording it comes from, counted from 0.
    """

    record: KeyframeRecord
    pose: np.ndarray
    session: int


@dataclass(frozen=True)
class SiteMap:
    """A map.

    Attributes:
        camera: of all records.
        keyframes: in the order in which they were taken.
        edges: between them; keyframes are numbered as in `keyframes`.
    """

    camera: RecordCamera
    keyframes: Tuple[MapKeyframe, ...]
    edges: Tuple[Edge, ...]

    @property
    def poses(self) -> np.ndarray:
        """(N, 3) of all keyframes."""
        return np.array([keyframe.pose for keyframe in self.keyframes]).reshape(-1, 3)

    @property
    def size_m(self) -> Tuple[float, float]:
        """Extent of the keyframes along x and y."""
        x, y = np.ptp(self.poses[:, :2], axis=0) if self.keyframes else np.zeros(2)
        return float(x), float(y)

    @property
    def sessions(self) -> int:
        """How many recordings it is made of."""
        return len({keyframe.session for keyframe in self.keyframes})


def nearest_places(poses: np.ndarray, pose: np.ndarray, within_m: float, count: int) -> List[int]:
    """The nearest of (N, 3) poses to another, at most so many."""
    if not len(poses):
        return []
    apart = np.hypot(*(poses[:, :2] - pose[:2]).T)
    order = np.argsort(apart, kind="stable")[:count]
    return [int(i) for i in order if apart[i] <= within_m]


class Appearance:
    """What records look like: finds those that look like another one."""

    def __init__(self, records: Sequence[KeyframeRecord]) -> None:
        self._first = np.cumsum([0, *(len(record.corners.descriptor) for record in records)]).astype(np.int64)
        among = np.concatenate([NO_DESCRIPTORS, *(record.corners.descriptor for record in records)])
        self._among = np.ascontiguousarray(among.T)

    def alike(self, query: KeyframeRecord, count: int) -> List[int]:
        """The records that most descriptors of a query vote for, the best first, at most so many."""
        votes = vote(query.corners.descriptor, self._among, self._first, VOTE_BITS, TIE_BITS)
        order = np.argsort(-votes, kind="stable")[:count]
        return [int(i) for i in order if votes[i] > 0.0]
