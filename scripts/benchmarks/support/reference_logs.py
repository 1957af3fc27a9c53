# SPDX-License-Identifier: BSD-3-Clause
"""References from real logs, compared with the poses that others have corrected."""

from pathlib import Path
from typing import Iterator, Optional, Tuple

import numpy as np
from support.table import Row

from ceiling_dso_ros.io.carmen_log import CarmenLog, read_carmen_log
from ceiling_dso_ros.io.laser_scans import LaserScans
from ceiling_dso_ros.io.recording import WheelSamples, WheelUnit
from ceiling_dso_ros.io.warning_log import ignore_warning
from ceiling_dso_ros.lidar.mapping.landmarks import KeyframePoints, find_landmarks
from ceiling_dso_ros.lidar.reference import Reference, estimate_reference
from ceiling_dso_ros.lidar.rendering import draw_map, draw_trajectory
from ceiling_dso_ros.lidar.scans.poses import between, compose
from ceiling_dso_ros.lidar.scans.scan_points import ScanPoints
from ceiling_dso_ros.lidar.scans.wheel_motion import WheelMotions, wheel_motions

LOGS = ("intel-corrected.log.gz", "freiburg-101-corrected.log.gz")
NEAR_M, WAY_M = 2.0, 50.0  # of a revisit
SCALE_DRIFT, YAW_DRIFT_RAD_M = 0.02, 0.01  # of the odometry that is added
LANDMARK_M, SMALLEST_SIGMA_M = 0.15, 0.002
STEP_M, STEP_DEG, REVISIT_M = 0.03, 0.5, 0.06


def log_rows(folder: Path, out: Path) -> Iterator[Row]:
    """Each log without odometry, and with one to which drift was added; pictures of the maps are written to out."""
    for name in LOGS:
        log = read_carmen_log(folder / name, ignore_warning)
        for words, wheels in (("no odometry", None), ("odometry with drift", drifting(log))):
            reference = estimate_reference(log.scans, wheels, check_itself=False)
            subject = f"{name.partition('-corrected')[0]}, {words}"
            yield from _rows(subject, reference, log.corrected)
            scatter_mm = [1e3 * _scatter_m(reference.scans, poses) for poses in (reference.path.poses, log.corrected)]
            yield Row(subject, "scatter of the walls by these poses and by the corrected ones, mm", scatter_mm)
            picture = draw_trajectory(reference, draw_map(reference))
            (out / f"{subject.replace(', ', '_').replace(' ', '_')}.png").write_bytes(picture)


def drifting(log: CarmenLog) -> Optional[WheelMotions]:
    """The corrected motion, too long and turned the further it goes, with noise."""
    moved = between(log.corrected[:-1], log.corrected[1:])
    way_m = np.hypot(moved[:, 0], moved[:, 1])
    rng = np.random.default_rng(0)
    moved[:, :2] *= 1.0 + SCALE_DRIFT
    moved[:, 2] += YAW_DRIFT_RAD_M * way_m + 0.005 * rng.standard_normal(len(moved))
    moved[:, :2] += 0.01 * rng.standard_normal((len(moved), 2))
    poses = [np.zeros(3)]
    for step in moved:
        poses.append(compose(poses[-1], step))
    samples = WheelSamples(WheelUnit.POSES, log.scans.stamps_ns, np.array(poses), "odometry with drift")
    return wheel_motions(samples, None, ignore_warning)


def _rows(subject: str, reference: Reference, corrected: np.ndarray) -> Iterator[Row]:
    found = reference.path.poses
    step = between(between(corrected[:-1], corrected[1:]), between(found[:-1], found[1:]))
    yield Row(subject, "consecutive scans, m in the mean", [float(np.hypot(step[:, 0], step[:, 1]).mean())], STEP_M)
    yield Row(subject, "the same, degrees", [float(np.degrees(np.abs(step[:, 2])).mean())], STEP_DEG)
    first, second = revisits(corrected)
    again = between(between(corrected[first], corrected[second]), between(found[first], found[second]))
    apart_m = np.hypot(again[:, 0], again[:, 1])
    yield Row(subject, f"{len(first)} revisits, m in the mean", [float(apart_m.mean())], REVISIT_M)
    yield Row(subject, "the same, the worst", [float(apart_m.max())])
    yield Row(subject, "loops that are right", [int(np.count_nonzero(reference.solution.is_right))], low=1)


def _scatter_m(scans: LaserScans, poses: np.ndarray) -> float:
    """Standard deviation of the points of all scans across the walls that they make."""
    points = ScanPoints(scans)
    parts = [points.of(scan, np.zeros((2, 3))) for scan in range(len(scans))]
    return find_landmarks(KeyframePoints.of(parts, points.laser), poses, LANDMARK_M, SMALLEST_SIGMA_M).sigma_m


def revisits(poses: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """Pairs of indices of poses (N, 3) that are near each other, with a long way between."""
    way_m = np.append(0.0, np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T)))
    away_m = np.hypot(*(poses[:, None, :2] - poses[None, :, :2]).transpose(2, 0, 1))
    first, second = np.nonzero((away_m < NEAR_M) & (way_m[None, :] - way_m[:, None] > WAY_M))
    return first, second
