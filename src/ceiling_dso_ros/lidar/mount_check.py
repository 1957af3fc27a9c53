# SPDX-License-Identifier: BSD-3-Clause
"""Whether the mount of the laser fits to how a robot with two driven wheels moves: not sideways.

Where the mount is wrong by dx, dy, a, what is taken for the base is at dx, dy, turned by a, of the true one. It then
moves sideways: left = dx turn - a ahead.
"""

from dataclasses import dataclass
from typing import Optional

import numpy as np

from ceiling_dso_ros.lidar.scans.poses import between, logmap
from ceiling_dso_ros.lidar.scans.wheel_motion import WheelMotions

STEP_M, STEP_RAD = 0.3, 0.2  # of the motions that are looked at
FEWEST = 10
WRONG_RAD, WRONG_M, SIGMAS = np.radians(1.0), 0.03, 5.0
FAST_RAD = 0.05  # turned by the wheels; a motion that turns less has no direction


@dataclass(frozen=True)
class MountError:
    """What the motion says of an error of the mount.

    Attributes:
        yaw_rad, yaw_sigma_rad: of the laser, counter-clockwise.
        x_m, x_sigma_m: ahead.
        is_mirrored: the scans turn against the wheels: the laser is mounted upside down, or is not, against its mount.
    """

    yaw_rad: float
    yaw_sigma_rad: float
    x_m: float
    x_sigma_m: float
    is_mirrored: bool

    def describe(self) -> str:
        """What is wrong, in words; empty where nothing is."""
        if self.is_mirrored:
            return (
                "the scans turn the other way than the wheels: the laser is mounted upside down where the mount says "
                "that it is not, or left and right wheel are swapped; correct its roll in tf (180 degrees)"
            )
        parts = []
        if abs(self.yaw_rad) > max(WRONG_RAD, SIGMAS * self.yaw_sigma_rad):
            parts.append(f"its yaw by {np.degrees(self.yaw_rad):+.1f} degrees")
        if abs(self.x_m) > max(WRONG_M, SIGMAS * self.x_sigma_m):
            parts.append(f"its x by {self.x_m:+.3f} m")
        if not parts:
            return ""
        return f"the robot would drive sideways: correct the mount of the laser, {' and '.join(parts)}"


def check_mount(stamps_ns: np.ndarray, poses: np.ndarray, wheels: Optional[WheelMotions]) -> Optional[MountError]:
    """Compare the motion with that of a differential drive; None where the robot moves too little.

    Args:
        stamps_ns: (N,) of the poses.
        poses: (N, 3) of the base.
        wheels: tell whether the turns have the same sense.
    """
    index = _steps(poses)
    if len(index) < FEWEST:
        return None
    first, last = index[:-1], index[1:]
    ahead, left, turn = logmap(between(poses[first], poses[last])).T
    is_mirrored = False
    if wheels is not None:
        covered = wheels.covers(stamps_ns[first], stamps_ns[last])
        driven = wheels.between(stamps_ns[first], stamps_ns[last])[:, 2]
        turning = covered & (np.abs(driven) > FAST_RAD)
        is_mirrored = bool(turning.sum() >= 3 and np.sum(driven[turning] * turn[turning]) < 0.0)
    A = np.column_stack([-ahead, turn])
    weights = np.ones(len(A))
    solved = np.zeros(2)
    for _ in range(5):  # outliers are those of a slide
        normal = A.T @ (weights[:, None] * A) + 1e-6 * np.eye(2)
        solved = np.linalg.solve(normal, A.T @ (weights * left))
        residual = left - A @ solved
        scale = max(1.5 * float(np.median(np.abs(residual))), 1e-4)
        weights = 1.0 / (1.0 + (residual / (3.0 * scale)) ** 2)
    sigmas = scale * np.sqrt(np.diag(np.linalg.inv(normal)))
    return MountError(float(solved[0]), float(sigmas[0]), float(solved[1]), float(sigmas[1]), is_mirrored)


def _steps(poses: np.ndarray) -> np.ndarray:
    """Indices of poses that are a step apart."""
    arcs = logmap(between(poses[:-1], poses[1:]))
    moved = np.cumsum(np.hypot(arcs[:, 0], arcs[:, 1]) / STEP_M + np.abs(arcs[:, 2]) / STEP_RAD)
    return np.unique(np.searchsorted(moved, np.arange(0.0, moved[-1] if len(moved) else 0.0)))
