# SPDX-License-Identifier: BSD-3-Clause
"""The safety laser scanner at the front of the robot: 270 degrees, 30 m, in a plane 0.21 m above the floor.

Its mirror turns while the robot drives: each ray starts from another place, `TIME_INCREMENT_S` after the one before.
"""

import numpy as np

from ceiling_dso_ros.simulation.driving.motion import BaseMotion
from ceiling_dso_ros.simulation.obstacles import Obstacles
from ceiling_dso_ros.simulation.robot import T_BASE_LASER

SCAN_HZ = 10.0  # turns of the mirror per second
SCAN_ANGLES = np.radians(np.linspace(-135.0, 135.0, 541))
TIME_INCREMENT_S = float(SCAN_ANGLES[1] - SCAN_ANGLES[0]) / (2 * np.pi * SCAN_HZ)
SWEEP_S = TIME_INCREMENT_S * (len(SCAN_ANGLES) - 1)
SCAN_RANGE_M = (0.1, 30.0)
SCAN_NOISE_M = 0.01
RESOLUTION_M = 0.001
LOST_SHARE = 0.002  # of the rays, which do not come back from dark or shiny surfaces


class LaserScanner:
    """Measures ranges while the robot drives.

    Args:
        obstacles: what it sees.
        rng: for the noise.
    """

    def __init__(self, obstacles: Obstacles, rng: np.random.Generator) -> None:
        self._obstacles = obstacles
        self._rng = rng

    def sweep(self, motion: BaseMotion, start_s: float) -> np.ndarray:
        """Ranges at SCAN_ANGLES, (541,) metres, inf where nothing is within reach.

        Args:
            motion: of the base.
            start_s: time of the first ray.
        """
        time_s = start_s + TIME_INCREMENT_S * np.arange(len(SCAN_ANGLES))
        x, y, yaw = np.ascontiguousarray(motion.poses(time_s).T)  # or the last bit depends on their place in memory
        origins = np.stack([x + T_BASE_LASER[0, 3] * np.cos(yaw), y + T_BASE_LASER[0, 3] * np.sin(yaw)], axis=1)
        rays = np.stack([np.cos(SCAN_ANGLES + yaw), np.sin(SCAN_ANGLES + yaw)], axis=1)
        ranges = self._obstacles.ranges_m(origins, rays, time_s)
        ranges = ranges + SCAN_NOISE_M * self._rng.standard_normal(len(rays))
        ranges = np.round(ranges / RESOLUTION_M) * RESOLUTION_M
        returned = self._rng.random(len(rays)) >= LOST_SHARE
        return np.where(returned & (ranges >= SCAN_RANGE_M[0]) & (ranges <= SCAN_RANGE_M[1]), ranges, np.inf)
