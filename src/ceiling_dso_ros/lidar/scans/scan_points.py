# SPDX-License-Identifier: BSD-3-Clause
"""The points of scans, freed of the motion during the scan."""

import numpy as np

from ceiling_dso_ros.dso.durations import nanoseconds, seconds
from ceiling_dso_ros.io.laser_scans import LaserScans
from ceiling_dso_ros.lidar.scans.poses import logmap
from ceiling_dso_ros.lidar.scans.scan_kernels import densified, undistorted_points

SPACING_M = 0.05  # of points on one surface


class ScanPoints:
    """Makes points of base_link of each scan.

    Attributes:
        laser: (2,) its place in base_link.
        end_stamps_ns: (N,) int64 of the last rays; a little after the first where it is unknown when rays are cast.
    """

    LEAST_SWEEP_S = 0.01

    def __init__(self, scans: LaserScans) -> None:
        """Of all scans; the laser may be mounted upside down, its z and its tilt do not matter."""
        self._scans = scans
        self._mount = np.ascontiguousarray(scans.T_base_laser[:2][:, [0, 1, 3]])
        self.laser = np.array(scans.T_base_laser[:2, 3])
        sweep_s = np.maximum(scans.sweep_s, self.LEAST_SWEEP_S)
        self.end_stamps_ns = scans.stamps_ns + np.array([nanoseconds(each) for each in sweep_s.tolist()], np.int64)

    def of(self, scan: int, motion: np.ndarray) -> np.ndarray:
        """(n, 2) points of a scan in base_link at its stamp; the motion is (2, 3) twist and its change per second."""
        points, _ = undistorted_points(self._scans.ranges_m[scan], self._scans.geometry[scan], self._mount, motion)
        return points

    def dense(self, scan: int, motion: np.ndarray) -> np.ndarray:
        """The same with points between those of neighbouring rays that are on one surface."""
        geometry = self._scans.geometry[scan]
        points, rays = undistorted_points(self._scans.ranges_m[scan], geometry, self._mount, motion)
        return densified(points, rays, self.laser, abs(float(geometry[1])), SPACING_M)

    def twists_over_sweeps(self, moved: np.ndarray) -> np.ndarray:
        """(N, 3) twists of motions (N, 3) from the stamps to `end_stamps_ns`."""
        return logmap(moved) / seconds(self.end_stamps_ns - self._scans.stamps_ns)[:, None]


def steady(twists: np.ndarray) -> np.ndarray:
    """Motions (..., 2, 3) that keep twists (..., 3)."""
    return np.stack([twists, np.zeros_like(twists)], axis=-2)
