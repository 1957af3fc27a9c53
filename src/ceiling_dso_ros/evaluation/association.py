# SPDX-License-Identifier: BSD-3-Clause
"""Pairs the poses of two trajectories by their stamps: equation (13)."""

from typing import Tuple

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from ceiling_dso_ros.dso.durations import nanoseconds, seconds


def associate(
    stamps_ns: np.ndarray, reference_stamps_ns: np.ndarray, max_difference_s: float
) -> Tuple[np.ndarray, np.ndarray]:
    """Pair the stamps that are each other's nearest and at most max_difference_s apart.

    Being nearest in both directions makes the pairing one-to-one and keeps it in the order of time.

    Args:
        stamps_ns: (N,) int64, nanoseconds, increasing.
        reference_stamps_ns: (M,) int64, nanoseconds, increasing.
        max_difference_s: tau of equation (13), seconds.

    Returns:
        Indices into stamps_ns and into reference_stamps_ns, both (P,) int, increasing.
    """
    if len(stamps_ns) == 0 or len(reference_stamps_ns) == 0:
        return np.empty(0, int), np.empty(0, int)
    # Opposite choices, so that stamps exactly between those of the reference are paired, too.
    nearest_reference = _nearest(stamps_ns, reference_stamps_ns, earlier_of_two=True)
    nearest_stamp = _nearest(reference_stamps_ns, stamps_ns, earlier_of_two=False)
    index = np.arange(len(stamps_ns))
    difference_ns = np.abs(stamps_ns - reference_stamps_ns[nearest_reference])
    paired = (nearest_stamp[nearest_reference] == index) & (difference_ns <= nanoseconds(max_difference_s))
    return index[paired], nearest_reference[paired]


def interpolate_poses(stamps_ns: np.ndarray, poses: np.ndarray, wanted_ns: np.ndarray) -> np.ndarray:
    """Poses at other stamps: positions linearly, rotations along the shortest arc.

    Args:
        stamps_ns: (N,) int64, nanoseconds, strictly increasing, at least two.
        poses: (N, 4, 4) float64.
        wanted_ns: (M,) int64, nanoseconds, all within the range of stamps_ns.

    Returns:
        (M, 4, 4) float64.
    """
    # seconds from the first stamp: the same numbers wherever the clock has its origin
    times_s, wanted_s = (seconds(ns - stamps_ns[0]) for ns in (stamps_ns, wanted_ns))
    interpolated = np.tile(np.eye(4), (len(wanted_s), 1, 1))
    interpolated[:, :3, :3] = Slerp(times_s, Rotation.from_matrix(poses[:, :3, :3]))(wanted_s).as_matrix()
    for axis in range(3):
        interpolated[:, axis, 3] = np.interp(wanted_s, times_s, poses[:, axis, 3])
    return interpolated


def _nearest(stamps_ns: np.ndarray, among_ns: np.ndarray, earlier_of_two: bool) -> np.ndarray:
    """For each stamp the index of the nearest of among_ns; of two that are equally near the earlier or the later."""
    after = np.clip(np.searchsorted(among_ns, stamps_ns), 1, max(len(among_ns) - 1, 1))
    after = np.minimum(after, len(among_ns) - 1)
    before = np.maximum(after - 1, 0)
    to_before, to_after = stamps_ns - among_ns[before], among_ns[after] - stamps_ns
    return np.where(to_before <= to_after if earlier_of_two else to_before < to_after, before, after)
