# SPDX-License-Identifier: BSD-3-Clause
"""Motion of the robot in the plane between two images by the visual odometry, in VO units."""

import math
from dataclasses import dataclass, field, replace
from typing import Optional

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
        covariance: (3, 3) of (shift, yaw) by the error of the second image as the odometry computes it, units and rad;
            zeros where it does not. See `with_start`.
    """

    shift: np.ndarray
    climb: float
    yaw: float
    tilt: np.ndarray
    lever_m: np.ndarray
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))

    @staticmethod
    def from_camera(
        T_first_second: np.ndarray, T_base_camera: np.ndarray, covariance: Optional[np.ndarray] = None
    ) -> "VisualMotion":
        """From the motion of the camera.

        Args:
            T_first_second: (4, 4) pose of the second camera in the first, translation in VO units.
            T_base_camera: (4, 4).
            covariance: (6, 6) of (translation, rotation), right-multiplied on T_first_second; None: not known.
        """
        R_base_camera = T_base_camera[:3, :3]
        R = R_base_camera @ T_first_second[:3, :3] @ R_base_camera.T
        t = R_base_camera @ T_first_second[:3, 3]
        yaw = math.atan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1])
        planar_covariance = np.zeros((3, 3)) if covariance is None else _on_floor(covariance, R_base_camera, yaw)
        return VisualMotion(t[:2], float(t[2]), yaw, R[:2, 2], T_base_camera[:3, 3], planar_covariance)

    def then(self, further: "VisualMotion") -> "VisualMotion":
        """This motion and the one that follows it; the error of the image between them is in none of its ends."""
        turn = planar.rotation(self.yaw)
        return VisualMotion(
            self.shift + turn @ further.shift,
            self.climb + further.climb,
            self.yaw + further.yaw,
            self.tilt + turn @ further.tilt,
            self.lever_m,
            further.covariance,
        )

    def with_start(self, before: "Optional[VisualMotion]") -> "VisualMotion":
        """This motion with the errors of both of its images, as it is wrong on its own.

        In a chain of motions the error of an image between two of them is in both and falls out, so that each of them
        has that of its end alone.

        Args:
            before: ends where this one begins; None where there is none, and the error of its end is not known.
        """
        if before is None:
            return self
        by_start = np.eye(3)
        by_start[:2, :2] = planar.rotation(-before.yaw)
        by_start[:2, 2] = -self.shift[1], self.shift[0]
        return replace(self, covariance=self.covariance + by_start @ before.covariance @ by_start.T)

    def noise(self, config: VisualConfig) -> np.ndarray:
        """(3, 3) covariance of (shift, yaw), units and rad.

        The odometry's own is that of tracking one image on the map as it is; the constants are for the map's errors.
        """
        return (
            np.diag([config.translation_sigma, config.translation_sigma, config.yaw_sigma_rad]) ** 2 + self.covariance
        )

    def is_possible(self, scale: Optional[float], config: VisualConfig) -> bool:
        """Whether the motion is possible on a floor and, where the scale is known, metres per unit, for the wheels."""
        return self.on_floor(config) and (scale is None or self.on_wheels(scale, config))

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


def _on_floor(covariance: np.ndarray, R_base_camera: np.ndarray, yaw: float) -> np.ndarray:
    """(3, 3) of (shift, yaw) in the base at the first image, from (6, 6) in the camera's axes at the second."""
    by_camera = np.zeros((3, 6))
    by_camera[:2, :3] = planar.rotation(yaw) @ R_base_camera[:2]
    by_camera[2, 3:] = R_base_camera[2]
    return by_camera @ covariance @ by_camera.T
