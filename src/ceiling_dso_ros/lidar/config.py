# SPDX-License-Identifier: BSD-3-Clause
"""Settings of the reference trajectory."""

import math
from dataclasses import dataclass

from ceiling_dso_ros.fusion.config import require_ranges


@dataclass(frozen=True)
class LidarConfig:
    """Settings of the reference trajectory; lengths in metres, angles in radians.

    Attributes:
        cell_m: of the normal distributions of a submap.
        raster_m: of the likelihoods that are searched.
        range_sigma_m: smallest standard deviation of points across the surface that they are on.
        keyframe_m, keyframe_rad: a scan that is so far from the last keyframe becomes one.
        submap_keyframes: of which a submap consists; each keyframe is in two submaps.
        least_fit: share of the points that must fit, else a scan has no pose of its own.
        acceleration_m_s2, acceleration_rad_s2: largest of a robot, where no wheels tell its motion.
        landmark_m: half the size of the pieces into which walls are cut for the joint solution.
        converged_m, converged_rad: the map has been made again often enough when no pose moves further.
    """

    cell_m: float = 0.1
    raster_m: float = 0.05
    range_sigma_m: float = 0.01
    keyframe_m: float = 0.4
    keyframe_rad: float = math.radians(15.0)
    submap_keyframes: int = 24
    least_fit: float = 0.3
    acceleration_m_s2: float = 1.0
    acceleration_rad_s2: float = 2.0
    landmark_m: float = 0.15
    converged_m: float = 5e-4
    converged_rad: float = 2e-4

    def check(self) -> None:
        """Raise ConfigError when a value is out of range."""
        require_ranges(
            "lidar",
            self,
            cell_m=(0.02, 1.0),
            raster_m=(0.01, 0.5),
            range_sigma_m=(0.001, 0.2),
            keyframe_m=(0.05, 5.0),
            keyframe_rad=(0.02, 1.5),
            submap_keyframes=(4, 1000),
            least_fit=(0.05, 0.95),
            acceleration_m_s2=(0.01, 50.0),
            acceleration_rad_s2=(0.01, 100.0),
            landmark_m=(0.02, 2.0),
            converged_m=(1e-6, 0.1),
            converged_rad=(1e-6, 0.1),
        )
