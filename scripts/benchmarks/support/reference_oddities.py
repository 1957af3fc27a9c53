# SPDX-License-Identifier: BSD-3-Clause
"""What a reference says where its LiDAR sees little, or what is not so."""

from dataclasses import replace
from typing import Iterator, List, Optional, Tuple

import numpy as np
from support.table import Row

from ceiling_dso_ros.experiments.scanned_drive import ReferenceErrors, ScannedDrive, with_ranges
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.io.laser_scans import LaserScans
from ceiling_dso_ros.lidar.reference import Reference, estimate_reference
from ceiling_dso_ros.lidar.scans.wheel_motion import WheelMotions
from ceiling_dso_ros.lidar.uncertainty import aligned_errors
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.obstacles import Obstacles
from ceiling_dso_ros.simulation.sensors.laser import LaserModel

SEED = 110  # of those for judging
LASER = LaserModel(rays=1081, range_noise_m=0.02)
GLASS = LaserModel(rays=1081, range_noise_m=0.02, lost_share=0.6)
CORRIDOR = Obstacles(np.array([[[-80.0, -0.4], [80.0, -0.4]], [[-80.0, 2.0], [80.0, 2.0]]]))  # its ends out of reach
SIGMAS = 3.0


def oddity_rows() -> Iterator[Row]:
    """Each with what was said."""
    yield from _corridor()
    yield from _standing()
    drive = ScannedDrive(SimulationConfig("loops", seed=SEED, duration_s=40.0, laser=LASER, traffic=5))
    yield from _dirty(drive)
    yield from _upside_down()
    yield from _wrong_mounts(drive)


def _corridor() -> Iterator[Row]:
    """Along x the walls tell nothing."""
    drive = ScannedDrive(SimulationConfig("straight", seed=SEED, laser=GLASS), CORRIDOR)
    for words, wheels in (("with wheels", drive.wheels), ("without wheels", None)):
        reference, said = _estimate(drive.scans, wheels)
        errors = aligned_errors(reference.path.poses, drive.truth)
        subject = f"glass corridor, {words}"
        along_m = np.sqrt(reference.covariances[:, 0, 0])
        yield Row(subject, "largest error along / its standard deviation", [_largest(errors[:, 0], along_m)], SIGMAS)
        yield Row(subject, "standard deviation along / across", [_ratio(reference)], low=5.0)
        yield Row(subject, "scans said to be in a corridor, %", [100.0 * float(reference.is_corridor.mean())], low=90.0)
        yield Row(subject, "lines said", [len(said)], low=1)


def _standing() -> Iterator[Row]:
    drive = ScannedDrive(SimulationConfig("square", seed=SEED, duration_s=30.0, laser=LASER, traffic=5))
    still = drive.scans.select(np.arange(9))  # before it starts
    reference, _ = _estimate(still, drive.wheels)
    errors = ReferenceErrors.of(reference, drive.truth[:9])
    yield Row("standing", "RMSE of the position, mm", [1e3 * errors.position_m], 10.0)
    yield Row("standing", "NEES / 3", [errors.nees], 3.0)


def _dirty(drive: ScannedDrive) -> Iterator[Row]:
    rng = np.random.default_rng(SEED)
    lost = rng.random(drive.scans.ranges_m.shape) < 0.5
    reference, said = _estimate(with_ranges(drive.scans, np.where(lost, np.nan, drive.scans.ranges_m)), drive.wheels)
    yield from _errors("half of the rays lost", reference, drive.truth, said)


def _upside_down() -> Iterator[Row]:
    config = SimulationConfig("loops", seed=SEED, duration_s=40.0, laser=replace(LASER, clockwise=True))
    drive = ScannedDrive(config)
    reference, _ = _estimate(drive.scans, drive.wheels)
    yield from _errors("angle_increment below zero", reference, drive.truth)
    turned = np.diag([1.0, -1.0, -1.0, 1.0])
    geometry = drive.scans.geometry * (-1.0, -1.0, 1.0)
    hanging = replace(drive.scans, geometry=geometry, T_base_laser=drive.scans.T_base_laser @ turned)
    reference, _ = _estimate(hanging, drive.wheels)
    yield from _errors("mounted upside down", reference, drive.truth)
    unsaid = replace(drive.scans, geometry=geometry)
    _, said = _estimate(unsaid, drive.wheels)
    yield Row("upside down, not in the mount", "lines that say so", [_count(said, "upside down")], 1, 1)


def _wrong_mounts(drive: ScannedDrive) -> Iterator[Row]:
    for words, error in (("yaw by 5 degrees", (0.0, 0.0, np.radians(5.0))), ("x by 0.1 m", (0.1, 0.0, 0.0))):
        mount = planar.lift(np.array(error)) @ drive.scans.T_base_laser
        _, said = _estimate(replace(drive.scans, T_base_laser=mount), drive.wheels)
        yield Row(f"mount wrong, {words}", "lines that say so", [_count(said, "correct the mount")], 1, 1)


def _estimate(scans: LaserScans, wheels: Optional[WheelMotions]) -> Tuple[Reference, List[str]]:
    said: List[str] = []
    return estimate_reference(scans, wheels, check_itself=False, warn=said.append), said


def _errors(subject: str, reference: Reference, truth: np.ndarray, said: Optional[List[str]] = None) -> Iterator[Row]:
    errors = ReferenceErrors.of(reference, truth)
    yield Row(subject, "RMSE of the position, mm", [1e3 * errors.position_m], 10.0)
    yield Row(subject, "NEES / 3", [errors.nees], 2.0)
    if said is not None:
        yield Row(subject, "lines said", [len(said)], low=1)


def _largest(errors: np.ndarray, sigmas: np.ndarray) -> float:
    return float(np.max(np.abs(errors) / sigmas))


def _ratio(reference: Reference) -> float:
    variances = np.median(np.einsum("nii->ni", reference.covariances), axis=0)
    return float(np.sqrt(variances[0] / variances[1]))


def _count(said: List[str], words: str) -> int:
    return sum(words in line for line in said)
