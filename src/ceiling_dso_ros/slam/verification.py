# SPDX-License-Identifier: BSD-3-Clause
"""Whether two keyframes show the same place, and the motion between them."""

from collections import OrderedDict
from dataclasses import dataclass
from typing import Optional, Tuple, Union

import numpy as np

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.slam.alignment import Aligner, Alignment, PreparedView
from ceiling_dso_ros.slam.deciding import Gate
from ceiling_dso_ros.slam.matching_kernels import motions_of_pairs, nearest
from ceiling_dso_ros.slam.records import KeyframeRecord, RecordCamera

MOST_BITS = 64  # between matched descriptors
RATIO = 0.85  # of the nearest to the second nearest
MOST_MATCHES = 160
TOLERANCE_PX = 2.0  # of the kept image
SAME_HEIGHT = 0.04  # relative: matched points have one height
FEWEST_INLIERS = 10
SECOND_SHARE = 0.5  # a second motion that so many of the inliers agree with makes the first one doubtful
LEAST_EXPECTED_CORRELATION = 0.5  # where the corners say nothing
LEAST_CORRELATION = 0.35  # of two views of different places, one in fifty is above 0.3
FEWEST_POINTS = 150
OTHERS_SHARE = 0.75
SHORTEST_PAIR = 0.1  # of the height
LARGEST_SIGMA_M = 0.06
LARGEST_REFINEMENT_PX = 1.5
KEPT_VIEWS = 400


@dataclass(frozen=True)
class Verified:
    """Two keyframes show the same place.

    Attributes:
        motion: (3,) T_a_b of base_link.
        covariance: (3, 3) of it, as in `fusion.planar`.
        inliers: matched corners that agree.
        correlation: of the grey values.
        others: (K, 3) other motions T_a_b that explain the views nearly as well.
    """

    motion: np.ndarray
    covariance: np.ndarray
    inliers: int
    correlation: float
    others: np.ndarray


@dataclass(frozen=True)
class Refused:
    """Two keyframes may show different places, for a reason in words."""

    reason: str


class Verifier:
    """Verifies pairs of records of one camera."""

    def __init__(self, camera: RecordCamera) -> None:
        self._aligner = Aligner(camera)
        # With the record itself: otherwise a new one could have the id of one that is gone.
        self._prepared: OrderedDict[int, Tuple[KeyframeRecord, PreparedView]] = OrderedDict()

    def verify(self, a: KeyframeRecord, b: KeyframeRecord, gate: Optional[Gate] = None) -> Union[Verified, Refused]:
        """Compare two records, whatever their poses are.

        Args:
            a, b: the records.
            gate: where b is expected, seen from a. Other explanations beyond it are not looked for. If it is narrow,
                the images are aligned from there where the corners say nothing.
        """
        guess = self._guess(a, b)
        least = LEAST_CORRELATION
        if isinstance(guess, Refused):
            expected = None if gate is None else gate.expected
            if expected is None:
                return guess
            guess, least = (expected, 0), LEAST_EXPECTED_CORRELATION
        motion, inliers = guess
        views = self._view(a), self._view(b)
        found = self._aligner.align(*views, motion)
        refusal = self._doubt(found, least)
        if not refusal and found is not None and inliers:
            moved = float(np.hypot(*planar.between(motion, found.motion)[:2]))
            if moved > LARGEST_REFINEMENT_PX * self._aligner.pixel_m(a.height_m, 0):
                refusal = f"corners and images disagree by {moved:.2f} m"
        if refusal or found is None:
            return Refused(refusal)
        covariance = found.covariance
        admits = None if gate is None else lambda motions: gate.admits(motions, covariance)
        others = self._aligner.others(*views, found, OTHERS_SHARE, admits)
        return Verified(found.motion, found.covariance, inliers, found.correlation, others)

    @staticmethod
    def _doubt(found: Optional[Alignment], least_correlation: float) -> str:
        if found is None:
            return "the images cannot be aligned"
        if found.points < FEWEST_POINTS:
            return f"only {found.points} points in common"
        if found.correlation < least_correlation:
            return f"the images differ: correlation {found.correlation:.2f}"
        if found.sigma_m > LARGEST_SIGMA_M:
            return "the images do not determine the motion"
        return ""

    def _guess(self, a: KeyframeRecord, b: KeyframeRecord) -> Union[Refused, Tuple[np.ndarray, int]]:
        """Motion T_a_b by the corners, and how many agree."""
        matches = _matches(a, b)
        if len(matches) < FEWEST_INLIERS:
            return Refused(f"{len(matches)} matches")
        at_a, at_b = a.corners.position[matches[:, 0]], b.corners.position[matches[:, 1]]
        pixel_m = self._aligner.pixel_m(a.height_m, 0)
        tolerance = (TOLERANCE_PX * pixel_m * at_a[:, 2] / a.height_m).astype(np.float32)
        motions = motions_of_pairs(at_a, at_b, tolerance, SHORTEST_PAIR * a.height_m)
        if not len(motions):
            return Refused("no motion fits two matches")
        best = motions[np.argmax(motions[:, 0])]
        if best[0] < FEWEST_INLIERS:
            return Refused(f"{best[0]:.0f} matches agree")
        apart = np.hypot(motions[:, 1] - best[1], motions[:, 2] - best[2])
        turned = np.abs(np.angle(np.exp(1j * (motions[:, 3] - best[3]))))
        others = motions[(apart > 4.0 * tolerance.max()) | (turned > 0.2), 0]
        if len(others) and others.max() > max(SECOND_SHARE * best[0], 4):
            return Refused(f"a second motion fits {others.max():.0f} matches, the first {best[0]:.0f}")
        return _fitted(at_a, at_b, tolerance, best[1:]), int(best[0])

    def _view(self, record: KeyframeRecord) -> PreparedView:
        key = id(record)
        if key not in self._prepared:
            self._prepared[key] = record, self._aligner.prepare(record)
            if len(self._prepared) > KEPT_VIEWS:
                self._prepared.popitem(last=False)
        self._prepared.move_to_end(key)
        return self._prepared[key][1]


def _matches(a: KeyframeRecord, b: KeyframeRecord) -> np.ndarray:
    """(M, 2) int64 corners of a and b that are each other's nearest, alike, unlike all others, and equally high."""
    if not len(a.corners.descriptor) or not len(b.corners.descriptor):
        return np.zeros((0, 2), np.int64)
    forth, back = (
        nearest(a.corners.descriptor, b.corners.descriptor),
        nearest(b.corners.descriptor, a.corners.descriptor),
    )
    i = np.arange(len(forth))
    j = forth[:, 0]
    heights = a.corners.position[:, 2], b.corners.position[j, 2]
    kept = (
        (back[j, 0] == i)
        & (forth[:, 1] <= MOST_BITS)
        & (forth[:, 1] < RATIO * forth[:, 2])
        & (np.abs(heights[0] - heights[1]) < SAME_HEIGHT * heights[0])
    )
    order = np.argsort(forth[kept, 1], kind="stable")[:MOST_MATCHES]
    return np.column_stack([i[kept], j[kept]])[order]


def _fitted(a: np.ndarray, b: np.ndarray, tolerance: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """The motion T_a_b that fits the matches that agree with a first one best, (3,), in least squares."""
    for _ in range(3):
        error = a[:, :2] - (b[:, :2] @ planar.rotation(motion[2]).T + motion[:2])
        agree = np.hypot(*error.T) < tolerance
        if np.count_nonzero(agree) < 2:
            return motion
        at_a, at_b = a[agree, :2].astype(np.float64), b[agree, :2].astype(np.float64)
        mean_a, mean_b = at_a.mean(axis=0), at_b.mean(axis=0)
        p, q = at_a - mean_a, at_b - mean_b
        yaw = np.arctan2(np.sum(q[:, 0] * p[:, 1] - q[:, 1] * p[:, 0]), np.sum(q * p))
        motion = np.array([*(mean_a - planar.rotation(yaw) @ mean_b), yaw])
    return motion
