# SPDX-License-Identifier: BSD-3-Clause
"""The safety laser scanner at the front of the robot: 270 degrees, 30 m, in a plane 0.21 m above the floor.

Its mirror turns while the robot drives: each ray starts from another place, `time_increment_s` after the one before.
"""

from dataclasses import dataclass

import numpy as np

from ceiling_dso_ros.dso.config import require
from ceiling_dso_ros.simulation.driving.motion import BaseMotion
from ceiling_dso_ros.simulation.obstacles import Obstacles
from ceiling_dso_ros.simulation.robot import T_BASE_LASER

SCAN_HZ = 10.0  # turns of the mirror per second
FIELD_DEG = 270.0  # of view, symmetrical about ahead
SWEEP_S = FIELD_DEG / 360.0 / SCAN_HZ  # from the first ray to the last
SCAN_RANGE_M = (0.1, 30.0)
RESOLUTION_M = 0.001


@dataclass(frozen=True)
class LaserModel:
    """What differs from scanner to scanner.

    Attributes:
        rays: of a scan.
        range_noise_m: standard deviation of a range.
        lost_share: share of the rays that do not come back from dark or shiny surfaces.
        clockwise: the mirror turns clockwise, from the left to the right.
    """

    rays: int = 541
    range_noise_m: float = 0.01
    lost_share: float = 0.002
    clockwise: bool = False

    @property
    def angles(self) -> np.ndarray:
        """(rays,) in the order in which they are cast, rad."""
        first_deg = FIELD_DEG / 2 if self.clockwise else -FIELD_DEG / 2
        return np.radians(np.linspace(first_deg, -first_deg, self.rays))

    @property
    def time_increment_s(self) -> float:
        """From ray to ray."""
        first, second = self.angles[:2]
        return float(abs(second - first)) / (2 * np.pi * SCAN_HZ)

    def check(self) -> None:
        """Raise ConfigError when a value is out of range."""
        require(2 <= self.rays <= 20_000, f"laser.rays {self.rays}: 2 to 20000")
        require(0.0 <= self.range_noise_m <= 1.0, f"laser.range_noise_m {self.range_noise_m:g}: 0 to 1")
        require(0.0 <= self.lost_share <= 1.0, f"laser.lost_share {self.lost_share:g}: 0 to 1")


class LaserScanner:
    """Measures ranges while the robot drives.

    Args:
        obstacles: what it sees.
        rng: for the noise.
        model: of the scanner.
    """

    def __init__(self, obstacles: Obstacles, rng: np.random.Generator, model: LaserModel = LaserModel()) -> None:
        self._obstacles, self._rng, self._model = obstacles, rng, model
        self._angles = model.angles

    def sweep(self, motion: BaseMotion, start_s: float) -> np.ndarray:
        """Ranges at the angles of the model, (rays,) metres, inf where nothing is within reach.

        Args:
            motion: of the base.
            start_s: time of the first ray.
        """
        time_s = start_s + self._model.time_increment_s * np.arange(len(self._angles))
        x, y, yaw = np.ascontiguousarray(motion.poses(time_s).T)  # or the last bit depends on their place in memory
        origins = np.stack([x + T_BASE_LASER[0, 3] * np.cos(yaw), y + T_BASE_LASER[0, 3] * np.sin(yaw)], axis=1)
        rays = np.stack([np.cos(self._angles + yaw), np.sin(self._angles + yaw)], axis=1)
        ranges = self._obstacles.ranges_m(origins, rays, time_s)
        ranges = ranges + self._model.range_noise_m * self._rng.standard_normal(len(rays))
        ranges = np.round(ranges / RESOLUTION_M) * RESOLUTION_M
        returned = self._rng.random(len(rays)) >= self._model.lost_share
        return np.where(returned & (ranges >= SCAN_RANGE_M[0]) & (ranges <= SCAN_RANGE_M[1]), ranges, np.inf)
