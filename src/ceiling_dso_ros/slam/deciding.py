# SPDX-License-Identifier: BSD-3-Clause
"""Whether what was seen can be believed: gates, ambiguity, agreement of several keyframes along the way."""

from typing import List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from ceiling_dso_ros.fusion import planar

GATE = 16.27  # squared Mahalanobis distance that one in a thousand exceeds, three dimensions
WIDE_GATE = 27.9  # one in 250 000: other explanations within it count
STEP_WALK_M = 0.004  # standard deviation of the odometry after a metre, in addition to its own
STEP_WALK_RAD = 0.0005
EXPECTED_SIGMA_M = 0.1
LARGEST_DIFFERENCE_M = 0.15  # between sightings that agree
LARGEST_DIFFERENCE_RAD = 0.02


class Place(NamedTuple):
    """A (3,) pose of base_link in map with its (3, 3) covariance, as in `fusion.planar`."""

    pose: np.ndarray
    covariance: np.ndarray


class Sighting(NamedTuple):
    """A keyframe of the map that was seen again.

    Attributes:
        query: running number of the keyframe that saw it.
        target: number of the keyframe of the map.
        motion: (3,) T_target_query.
        covariance: (3, 3) of it.
        others: (K, 3) other motions that explain the views nearly as well.
    """

    query: int
    target: int
    motion: np.ndarray
    covariance: np.ndarray
    others: np.ndarray


def distance(predicted: np.ndarray, covariance: np.ndarray, found: np.ndarray) -> float:
    """Squared Mahalanobis distance of a (3,) motion from a predicted one."""
    error = planar.between(predicted, found)
    return float(error @ np.linalg.solve(covariance, error))


def carried(covariance: np.ndarray, motion: np.ndarray, step_covariance: np.ndarray) -> np.ndarray:
    """Covariance of a pose after a further motion, (3, 3)."""
    back = planar.adjoint(planar.inverse(motion))
    return back @ covariance @ back.T + step_covariance


def walked(motion: np.ndarray) -> np.ndarray:
    """Covariance to add to that of the odometry for what it does not know of: errors of scale and tilt, (3, 3)."""
    way = float(np.hypot(*motion[:2])) + 0.1 * abs(motion[2]) + 1e-3
    return way * np.diag([STEP_WALK_M**2, STEP_WALK_M**2, STEP_WALK_RAD**2])


class Gate(NamedTuple):
    """Where a keyframe is expected, seen from another: (3,) T_target_query with its covariance."""

    predicted: np.ndarray
    covariance: np.ndarray

    @property
    def expected(self) -> Optional[np.ndarray]:
        """The predicted motion if images can be aligned from there; None if it is not known well enough."""
        sigma_m = np.sqrt(np.linalg.eigvalsh(self.covariance[:2, :2])[1])
        return self.predicted if sigma_m < EXPECTED_SIGMA_M else None

    def why_not(self, sighting: Sighting) -> str:
        """Why a sighting cannot be believed, in words; empty if it can."""
        total = self.covariance + sighting.covariance
        far = distance(self.predicted, total, sighting.motion)
        if far > GATE:
            return f"outside of the gate: {np.sqrt(far):.1f} sigma"
        if self.admits(sighting.others, sighting.covariance).any():
            return "ambiguous: another motion within the gate explains it as well"
        return ""

    def admits(self, motions: np.ndarray, covariance: np.ndarray) -> np.ndarray:
        """Which of (N, 3) motions T_target_query count as other explanations of a sighting, (N,) bool.

        Args:
            motions: by the images.
            covariance: (3, 3) of the sighting.
        """
        total = self.covariance + covariance
        turns = np.pi - (np.pi - (motions[:, 2] - self.predicted[2])) % (2.0 * np.pi)
        result = turns**2 < WIDE_GATE * total[2, 2]  # most are beyond the gate by their turn alone
        near = np.flatnonzero(result)
        shifts = (motions[near, :2] - self.predicted[:2]) @ planar.rotation(self.predicted[2])
        error = np.column_stack([shifts, turns[near]])
        result[near] = np.einsum("ni,in->n", error, np.linalg.solve(total, error.T)) < WIDE_GATE
        return result


def agreeing(estimates: Sequence[Tuple[int, np.ndarray, np.ndarray]]) -> List[List[int]]:
    """Groups of estimates of one pose that agree, the largest first, as indices.

    Args:
        estimates: query, (3,) pose and (3, 3) covariance of each.
    """
    groups: List[List[int]] = []
    for index, (_, pose, covariance) in enumerate(estimates):
        for group in groups:
            if all(_agree(estimates[other][1:], (pose, covariance)) for other in group):
                group.append(index)
                break
        else:
            groups.append([index])
    return sorted(groups, key=lambda group: -len({estimates[index][0] for index in group}))


def _agree(a: Tuple[np.ndarray, np.ndarray], b: Tuple[np.ndarray, np.ndarray]) -> bool:
    error = planar.between(a[0], b[0])
    if np.hypot(*error[:2]) > LARGEST_DIFFERENCE_M or abs(error[2]) > LARGEST_DIFFERENCE_RAD:
        return False
    return distance(a[0], a[1] + b[1], b[0]) < GATE
