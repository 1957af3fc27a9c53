# SPDX-License-Identifier: BSD-3-Clause
"""What a reference says of its own errors: from halves of its scans, and from its end to its beginning."""

from dataclasses import dataclass, replace
from typing import Optional

import numpy as np
from scipy.interpolate import CubicSpline

from ceiling_dso_ros.dso.durations import seconds
from ceiling_dso_ros.io.laser_scans import LaserScans
from ceiling_dso_ros.lidar.config import LidarConfig
from ceiling_dso_ros.lidar.mapping.joint_solution import solve_jointly
from ceiling_dso_ros.lidar.mapping.landmarks import KeyframePoints
from ceiling_dso_ros.lidar.mapping.solution import Solution, localise_scans, solve
from ceiling_dso_ros.lidar.scans.poses import Path, between, carried
from ceiling_dso_ros.lidar.scans.scan_points import ScanPoints
from ceiling_dso_ros.lidar.scans.sweep_motion import sweep_motions
from ceiling_dso_ros.lidar.scans.wheel_motion import WheelMotions
from ceiling_dso_ros.lidar.uncertainty import aligned_errors

LONGEST_STEP_S = 0.3  # between two scans: over a longer one, a pose between two others is not known well enough


@dataclass(frozen=True)
class Difference:
    """Root mean square of the differences of two trajectories after alignment, positions in metres, yaw in radians."""

    position_m: float
    yaw_rad: float

    @staticmethod
    def of(errors: np.ndarray) -> "Difference":
        """Of (N, 3) differences x, y, yaw."""
        squares = np.mean(errors**2, axis=0)
        return Difference(float(np.sqrt(squares[0] + squares[1])), float(np.sqrt(squares[2])))


def odd_against_even(
    scans: LaserScans, wheels: Optional[WheelMotions], config: LidarConfig, solution: Solution
) -> Optional[Difference]:
    """Each half of the scans localised in a map of its own; the difference, divided by the root of two.

    If the errors of scans are independent, it is as large as the error of the whole. None where scans are too rare to
    compare poses at different times, and no wheels tell the motion between.
    """
    count = len(scans)
    steps_s = seconds(np.diff(scans.stamps_ns))
    has_wheels = wheels is not None and bool(wheels.covers(scans.stamps_ns[:-1], scans.stamps_ns[1:]).all())
    if count < 8 or (not has_wheels and np.median(steps_s) > LONGEST_STEP_S):
        return None
    halves = [_half(scans, wheels, config, solution, parity) for parity in (0, 1)]
    odd = np.arange(1, count, 2)[:-1]
    even = Path(scans.stamps_ns[::2], halves[0])
    if has_wheels and wheels is not None:
        there = carried(even, wheels.path, scans.stamps_ns[odd])
    else:
        there = _between_neighbours(even, scans.stamps_ns[odd])
    return Difference.of(aligned_errors(halves[1][: len(odd)], there) / np.sqrt(2.0))


def backwards_against_forwards(
    scans: LaserScans, wheels: Optional[WheelMotions], config: LidarConfig, solution: Solution
) -> Difference:
    """The whole again, from the last scan to the first: what depends on where it began, and on chance."""
    other = solve(scans, wheels, config, backwards=True)
    return Difference.of(aligned_errors(solution.localisation.poses, other.localisation.poses))


def _half(
    scans: LaserScans, wheels: Optional[WheelMotions], config: LidarConfig, solution: Solution, parity: int
) -> np.ndarray:
    """(n, 3) poses of every second scan, in a map of keyframes that are such scans."""
    located = solution.localisation
    keyframes = np.minimum(solution.keyframes // 2 * 2 + parity, len(scans) - 1 - (len(scans) - 1 - parity) % 2)
    points = ScanPoints(scans)
    own = np.arange(parity, len(scans), 2)
    motions = sweep_motions(scans, points, wheels, located.poses, solution.track.twists)
    parts = KeyframePoints.of([points.of(scan, motions[scan]) for scan in keyframes.tolist()], points.laser)
    poses = located.poses[keyframes]
    relations = [replace(each, moved=between(poses[each.first], poses[each.second])) for each in solution.relations]
    joint = solve_jointly(parts, poses, relations, config)
    return localise_scans(points, motions, joint.landmark_map, located.poses, located.priors, own).poses


def _between_neighbours(path: Path, stamps_ns: np.ndarray) -> np.ndarray:
    """Poses of a path at other stamps by cubic polynomials, (M, 3)."""
    times_s, wanted_s = (seconds(ns - path.stamps_ns[0]) for ns in (path.stamps_ns, stamps_ns))
    unwrapped = np.column_stack([path.poses[:, :2], np.unwrap(path.poses[:, 2])])
    return CubicSpline(times_s, unwrapped)(wanted_s)
