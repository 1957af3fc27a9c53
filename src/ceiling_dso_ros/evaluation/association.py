"""Pairs the poses of two trajectories by their stamps: equation (13)."""

from typing import Tuple

import numpy as np
from scipy.spatial.transform import Rotation, Slerp


def associate(
    stamps_s: np.ndarray, reference_stamps_s: np.ndarray, max_difference_s: float
) -> Tuple[np.ndarray, np.ndarray]:
    """Pair the stamps that are each other's nearest and at most max_difference_s apart.

    Being nearest in both directions makes the pairing one-to-one and keeps it in the order of time.

    Args:
        stamps_s: (N,) float64, seconds, increasing.
        reference_stamps_s: (M,) float64, seconds, increasing.
        max_difference_s: tau of equation (13), seconds.

    Returns:
        Indices into stamps_s and into reference_stamps_s, both (P,) int, increasing.
    """
    if len(stamps_s) == 0 or len(reference_stamps_s) == 0:
        return np.empty(0, int), np.empty(0, int)
    nearest_reference = _nearest(stamps_s, reference_stamps_s)
    nearest_stamp = _nearest(reference_stamps_s, stamps_s)
    index = np.arange(len(stamps_s))
    difference_s = np.abs(stamps_s - reference_stamps_s[nearest_reference])
    paired = (nearest_stamp[nearest_reference] == index) & (difference_s <= max_difference_s)
    return index[paired], nearest_reference[paired]


def interpolate_poses(stamps_s: np.ndarray, poses: np.ndarray, wanted_s: np.ndarray) -> np.ndarray:
    """Poses at other stamps: positions linearly, rotations along the shortest arc.

    Args:
        stamps_s: (N,) float64, seconds, strictly increasing, at least two.
        poses: (N, 4, 4) float64.
        wanted_s: (M,) float64, seconds, all within the range of stamps_s.

    Returns:
        (M, 4, 4) float64.
    """
    interpolated = np.tile(np.eye(4), (len(wanted_s), 1, 1))
    interpolated[:, :3, :3] = Slerp(stamps_s, Rotation.from_matrix(poses[:, :3, :3]))(wanted_s).as_matrix()
    for axis in range(3):
        interpolated[:, axis, 3] = np.interp(wanted_s, stamps_s, poses[:, axis, 3])
    return interpolated


def _nearest(stamps_s: np.ndarray, among_s: np.ndarray) -> np.ndarray:
    """For each stamp the index of the nearest of among_s (the earlier of two equally near)."""
    after = np.clip(np.searchsorted(among_s, stamps_s), 1, max(len(among_s) - 1, 1))
    after = np.minimum(after, len(among_s) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(stamps_s - among_s[before] <= among_s[after] - stamps_s, before, after)
