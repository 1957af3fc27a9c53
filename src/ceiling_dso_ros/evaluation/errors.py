# SPDX-License-Identifier: BSD-3-Clause
"""Errors of an estimated trajectory against its reference.

Absolute and relative errors after Z. Zhang and D. Scaramuzza, "A tutorial on quantitative trajectory evaluation for
visual(-inertial) odometry", IROS 2018; the error over the distance is that of Ceiling-DSO, figures 8 and 9.
All functions take matched poses: row i of the estimate and row i of the reference are of the same instant.
"""

from dataclasses import dataclass
from typing import Sequence, Tuple

import numpy as np

# A sub-trajectory may be longer than its nominal length by this part; longer ones span a gap and are left out.
_LENGTH_TOLERANCE = 0.1
_LARGEST_SCATTER = 0.25  # of a constant rotation, relative to its angle: then it is no drift


@dataclass(frozen=True)
class Statistics:
    """Statistics of the absolute values of one kind of error, in its unit."""

    rmse: float
    mean: float
    median: float
    max: float

    @staticmethod
    def of(errors: np.ndarray) -> "Statistics":
        """Of (N,) float64, N at least 1."""
        magnitude = np.abs(errors)
        rmse = float(np.sqrt(np.mean(magnitude**2)))
        return Statistics(rmse, float(magnitude.mean()), float(np.median(magnitude)), float(magnitude.max()))


@dataclass(frozen=True)
class RelativeErrors:
    """Errors at the end of sub-trajectories of one length, each aligned at its first pose.

    Attributes:
        length_m: length of the sub-trajectories along the reference.
        count: number of sub-trajectories, which overlap.
        translation_m: position error at the end.
        translation_percent: the same over the sub-trajectory's own length.
        rotation_deg_per_m: angle of the orientation error over that length.
        yaw_deg_per_m: the part of it about the reference world's z axis.
    """

    length_m: float
    count: int
    translation_m: Statistics
    translation_percent: Statistics
    rotation_deg_per_m: Statistics
    yaw_deg_per_m: Statistics


def position_errors(aligned: np.ndarray, reference: np.ndarray, planar: bool) -> np.ndarray:
    """The paper's epsilon_i: distance of the positions, in x and y alone when planar.

    Args:
        aligned: (N, 4, 4) float64 estimate after equation (15).
        reference: (N, 4, 4) float64.
        planar: leave z out.

    Returns:
        (N,) float64, metres.
    """
    dimensions = 2 if planar else 3
    return np.linalg.norm((aligned - reference)[:, :dimensions, 3], axis=1)


def rotation_errors(aligned: np.ndarray, reference: np.ndarray, planar: bool) -> np.ndarray:
    """Angles between the orientations, or the yaw error's magnitude when planar; (N,) float64, degrees."""
    R_error = aligned[:, :3, :3] @ np.transpose(reference[:, :3, :3], (0, 2, 1))
    return np.abs(_yaw_deg(R_error)) if planar else _angle_deg(R_error)


def body_rotation_deg(aligned: np.ndarray, reference: np.ndarray) -> float:
    """Angle by which the bodies of two trajectories are turned against each other: R in R_reference = R_aligned R.

    It is that of the mean of R, and 0 where R is not constant: an orientation that drifts is of the same body.

    Args:
        aligned: (N, 4, 4) float64 estimate after equation (15).
        reference: (N, 4, 4) float64.

    Returns:
        Degrees.
    """
    R = np.transpose(aligned[:, :3, :3], (0, 2, 1)) @ reference[:, :3, :3]
    U, _, Vt = np.linalg.svd(R.mean(axis=0))
    mean = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    angle, scatter = _angle_deg(mean[None])[0], np.sqrt(np.mean(_angle_deg(mean.T @ R) ** 2))
    return float(angle) if scatter < _LARGEST_SCATTER * angle else 0.0


def distance_travelled_m(poses: np.ndarray, planar: bool = False) -> np.ndarray:
    """Distance travelled up to each pose of (N, 4, 4), N at least 1; (N,) float64, metres."""
    steps = np.diff(poses[:, : 2 if planar else 3, 3], axis=0)
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(steps, axis=1))])


def relative_errors(
    aligned: np.ndarray, reference: np.ndarray, lengths_m: Sequence[float], planar: bool
) -> Tuple[RelativeErrors, ...]:
    """Relative errors of all sub-trajectories of each length that the reference holds.

    A sub-trajectory starts at every pose and ends at the first one that is its length further along the reference.
    The estimate has the scale of its global alignment, because a monocular estimate has no metric scale.

    Args:
        aligned: (N, 4, 4) float64 estimate after equation (15).
        reference: (N, 4, 4) float64.
        lengths_m: lengths along the reference, metres, positive.
        planar: compare x, y and yaw alone.

    Returns:
        One entry for each length of which there is at least one sub-trajectory.
    """
    travelled_m = distance_travelled_m(reference, planar)
    results = []
    for length_m in lengths_m:
        first = np.arange(len(travelled_m))
        last = np.searchsorted(travelled_m, travelled_m + length_m)
        inside = last < len(travelled_m)
        first, last = first[inside], last[inside]
        fits = travelled_m[last] - travelled_m[first] <= (1.0 + _LENGTH_TOLERANCE) * length_m
        if fits.any():
            results.append(_relative_errors(aligned, reference, first[fits], last[fits], length_m, planar))
    return tuple(results)


def _relative_errors(
    aligned: np.ndarray, reference: np.ndarray, first: np.ndarray, last: np.ndarray, length_m: float, planar: bool
) -> RelativeErrors:
    """Move each sub-trajectory's first estimated pose onto the reference's and compare the last ones."""
    T_first_last = np.linalg.inv(aligned[first]) @ aligned[last]
    end = reference[first] @ T_first_last
    travelled_m = distance_travelled_m(reference, planar)
    actual_m = travelled_m[last] - travelled_m[first]
    translation_m = position_errors(end, reference[last], planar)
    R_error = end[:, :3, :3] @ np.transpose(reference[last, :3, :3], (0, 2, 1))
    yaw_deg = _yaw_deg(R_error)
    return RelativeErrors(
        length_m=float(length_m),
        count=len(first),
        translation_m=Statistics.of(translation_m),
        translation_percent=Statistics.of(100.0 * translation_m / actual_m),
        rotation_deg_per_m=Statistics.of((yaw_deg if planar else _angle_deg(R_error)) / actual_m),
        yaw_deg_per_m=Statistics.of(yaw_deg / actual_m),
    )


def _angle_deg(R: np.ndarray) -> np.ndarray:
    """Rotation angle of (N, 3, 3), degrees, by atan2 as that is exact for small angles, too."""
    axis = np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1)
    trace = np.trace(R, axis1=1, axis2=2)
    return np.degrees(np.arctan2(np.linalg.norm(axis, axis=1), trace - 1.0))


def _yaw_deg(R: np.ndarray) -> np.ndarray:
    """Rotation of (N, 3, 3) about z, degrees."""
    return np.degrees(np.arctan2(R[:, 1, 0] - R[:, 0, 1], R[:, 0, 0] + R[:, 1, 1]))
