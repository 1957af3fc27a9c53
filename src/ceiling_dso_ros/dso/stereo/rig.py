# SPDX-License-Identifier: BSD-3-Clause
"""The geometry of two cameras that are fixed to each other."""

from dataclasses import dataclass
from typing import Tuple

import numpy as np

from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.geometry.camera import PinholeCamera

SHORTEST_BASELINE_M = 1e-3


@dataclass(frozen=True)
class StereoRig:
    """A second camera, called right, whose images are taken at the same time as those that are tracked, called left.

    Attributes:
        right: pinhole of the right images, after undistortion.
        T_left_right: (4, 4) float64 pose of the right camera in the left one, metres; any direction will do.

    Raises:
        ValueError: that is not a rigid motion, or the cameras are in one place.
    """

    right: PinholeCamera
    T_left_right: np.ndarray

    def __post_init__(self) -> None:
        T = self.T_left_right
        rigid = T.shape == (4, 4) and np.isfinite(T).all() and np.allclose(T[3], [0.0, 0.0, 0.0, 1.0])
        if not rigid or not np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-3):
            raise ValueError("the pose of the second camera in the first is not a rigid motion")
        if self.baseline_m < SHORTEST_BASELINE_M:
            raise ValueError(f"the second camera is {1e3 * self.baseline_m:.2g} mm from the first: that tells no depth")

    @property
    def baseline_m(self) -> float:
        """Distance of the two cameras, metres."""
        return float(np.linalg.norm(self.T_left_right[:3, 3]))

    def warp(self, left_matrix: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """M, (3, 3), and t, (3,), float64, of the `Warp` from left pixels to right ones, for inverse depths in 1/m.

        Args:
            left_matrix: K of the left images, (3, 3) float64.
        """
        T_right_left = se3.inverse(self.T_left_right)
        K = self.right.matrix
        return K @ T_right_left[:3, :3] @ np.linalg.inv(left_matrix), K @ T_right_left[:3, 3]
