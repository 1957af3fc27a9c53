# SPDX-License-Identifier: BSD-3-Clause
"""Motion of the robot in the plane between two images by the visual odometry, in VO units."""

import math
from dataclasses import dataclass

import numpy as np

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.config import VisualConfig


@dataclass(frozen=True)
class VisualMotion:
    """Motion of the camera between two images, expressed in base_link at the first.

    Attributes:
        shift: (2,) translation of the camera along base x and y, VO units.
        climb: its translation along base z, VO units.
        yaw: turn about base z, rad.
        tilt: (2,) x and y of the base's z axis after the motion, about (pitch, -roll), rad.
        lever_m: (3,) position of the camera in the base, metres.
    """

    shift: np.ndarray
    climb: float
    yaw: float
    tilt: np.ndarray
    lever_m: np.ndarray

    @staticmethod
    def from_camera(T_first_second: np.ndarray, T_base_camera: np.ndarray) -> "VisualMotion":
        """From the (4, 4) pose of the second camera in the first, translation in VO units."""
        R_base_camera = T_base_camera[:3, :3]
        R = R_base_camera @ T_first_second[:3, :3] @ R_base_camera.T
        t = R_base_camera @ T_first_second[:3, 3]
        yaw = math.atan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1])
        return VisualMotion(t[:2], float(t[2]), yaw, R[:2, 2], T_base_camera[:3, 3])

    def on_floor(self, config: VisualConfig) -> bool:
        """Whether the motion is possible for a robot on a floor."""
        return bool(np.hypot(*self.tilt) < config.tilt_limit_rad and abs(self.climb) < self._stray_limit(config))

    def on_wheels(self, scale: float, config: VisualConfig) -> bool:
        """Whether the motion is possible for the wheels: approximately an arc; scale is metres per unit."""
        forward, left, turn = self.base_motion(scale)
        sideways = left * math.cos(0.5 * turn) - forward * math.sin(0.5 * turn)
        return bool(abs(sideways) < scale * self._stray_limit(config))

    def _stray_limit(self, config: VisualConfig) -> float:
        """Units."""
        return config.stray_limit + config.stray_share * float(np.hypot(*self.shift))

    def lever_shift(self, yaw: float) -> np.ndarray:
        """(2,) metres that the camera moves when the base turns on the spot by yaw and tilts as measured.

        The camera is high above the floor: at a height of 1 m, a tilt of 1 mrad moves it by 1 mm.
        """
        lever = self.lever_m[:2]
        return planar.rotation(yaw) @ lever - lever + self.lever_m[2] * self.tilt

    def base_motion(self, scale: float) -> np.ndarray:
        """(3,) pose of the base at the second image seen from the first, metres, given metres per unit."""
        return np.append(scale * self.shift - self.lever_shift(self.yaw), self.yaw)
