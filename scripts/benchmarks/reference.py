# SPDX-License-Identifier: BSD-3-Clause
"""The reference trajectory of the 2D LiDAR against its limits.

Simulated drives are in the hall of 21 x 15 m, with a scanner of 1081 rays and 20 mm of noise, and ten people and
vehicles that move through it. The seeds are those for judging, on which nothing is tuned. The logs are real ones, whose
poses another method has corrected: agreement, not truth.
"""

import argparse
import sys
from pathlib import Path
from typing import Callable, Dict, Iterator, List, Tuple

import numpy as np
from support.checkout import DATA
from support.reference_logs import log_rows
from support.reference_oddities import oddity_rows
from support.reference_speed import speed_rows
from support.table import Row, report

from ceiling_dso_ros.evaluation.alignment import AlignmentKind
from ceiling_dso_ros.evaluation.reference_sigma import ReferenceSigma, reference_part
from ceiling_dso_ros.evaluation.report import evaluate_trajectory
from ceiling_dso_ros.experiments.kept_runs import is_missing
from ceiling_dso_ros.experiments.scanned_drive import ReferenceErrors, ScannedDrive
from ceiling_dso_ros.io.pose_covariances import PoseCovariances
from ceiling_dso_ros.io.trajectory import Trajectory
from ceiling_dso_ros.lidar.reference import Reference, estimate_reference
from ceiling_dso_ros.lidar.scans.poses import matrices
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.sensors.laser import LaserModel

FIRST_SEED = 100  # of those for judging
DRIVES = (
    ("square", 30.0), ("loops", 60.0), ("stop_and_go", 90.0), ("spin", 40.0), ("straight", 50.0),
    ("loops", 120.0), ("square", 100.0), ("spin", 70.0), ("stop_and_go", 110.0), ("loops", 80.0),
)  # fmt: skip
LASER = LaserModel(rays=1081, range_noise_m=0.02)
TRAFFIC = 10
SECONDS_OF_SPEED = 120.0


def config(number: int) -> SimulationConfig:
    """Of one drive."""
    sequence, duration_s = DRIVES[number % len(DRIVES)]
    return SimulationConfig(sequence, seed=FIRST_SEED + number, duration_s=duration_s, laser=LASER, traffic=TRAFFIC)


def drives(options: argparse.Namespace) -> Iterator[Row]:
    """With wheels and without; and dead reckoning judged by the reference and by the truth."""
    count: int = options.drives
    errors: Dict[bool, List[ReferenceErrors]] = {True: [], False: []}
    differences_mm: List[float] = []
    sigmas_mm: List[float] = []
    for number in range(count):
        drive = ScannedDrive(config(number))
        for with_wheels, found in errors.items():
            reference = estimate_reference(drive.scans, drive.wheels if with_wheels else None, check_itself=False)
            found.append(ReferenceErrors.of(reference, drive.truth))
            if with_wheels:
                difference_m, sigma_m = judged(drive, reference)
                differences_mm.append(1e3 * difference_m)
                sigmas_mm.append(1e3 * sigma_m)
    for with_wheels, limit_m in ((True, 0.01), (False, 0.02)):
        subject = f"{count} drives, {'with' if with_wheels else 'without'} wheels"
        position_mm = [1e3 * each.position_m for each in errors[with_wheels]]
        nees = [each.nees for each in errors[with_wheels]]
        yield Row(subject, "RMSE of the position, mm", position_mm, 20.0)
        yield Row(subject, "its mean", [float(np.mean(position_mm))], 1e3 * limit_m)
        yield Row(subject, "RMSE of the yaw, degrees", [each.yaw_deg for each in errors[with_wheels]], 0.1)
        yield Row(subject, "NEES / 3", nees)
        yield Row(subject, "its mean", [float(np.mean(nees))], 1.2, 0.8)
    yield Row("wheels judged", "ATE by the reference and by the truth differ, mm", differences_mm)
    yield Row("wheels judged", "the same / the reference's own uncertainty", np.divide(differences_mm, sigmas_mm), 1.0)


def judged(drive: ScannedDrive, reference: Reference) -> Tuple[float, float]:
    """By how much the errors of the wheels differ by reference and by truth, and the reference's own uncertainty, m."""
    stamps_ns = reference.path.stamps_ns
    estimate = Trajectory.from_matrices(stamps_ns, matrices(drive.wheels.path.at(stamps_ns)))
    by_reference, by_truth = (
        evaluate_trajectory("wheel", estimate, against, AlignmentKind.SE2, 0.001)
        for against in (reference.trajectory(), drive.true_trajectory)
    )
    sigma = ReferenceSigma.of(PoseCovariances(stamps_ns, reference.covariances))
    part = reference_part(by_reference, sigma)
    return abs(by_reference.ate_m.rmse - by_truth.ate_m.rmse), part.position_m


def logs(options: argparse.Namespace) -> Iterator[Row]:
    """Real logs against their corrected poses."""
    folder = DATA / "lidar_logs"
    if not is_missing(folder):
        options.out.mkdir(parents=True, exist_ok=True)
        yield from log_rows(folder, options.out)


def speed(_: argparse.Namespace) -> Iterator[Row]:
    """Time of a drive with all checks, on one core, and how the memory grows with the number of scans."""
    yield from speed_rows(
        SimulationConfig("loops", seed=FIRST_SEED, duration_s=SECONDS_OF_SPEED, laser=LASER, traffic=TRAFFIC)
    )


def oddities(_: argparse.Namespace) -> Iterator[Row]:
    """Glass, dirt, standing still, scans upside down, wrong mounts."""
    yield from oddity_rows()


PARTS: Dict[str, Callable[[argparse.Namespace], Iterator[Row]]] = {
    part.__name__: part for part in (drives, logs, speed, oddities)
}


def main() -> int:
    """Print one table; 1 when a limit does not hold."""
    parser = argparse.ArgumentParser(prog="scripts/bench reference", description=__doc__)
    parser.add_argument("--drives", metavar="N", type=int, default=len(DRIVES), help="default %(default)s")
    parser.add_argument(
        "--out", metavar="DIR", type=Path, default=Path("out/bench/reference"), help="for pictures of the logs' maps"
    )
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS), metavar="PART", help=", ".join(PARTS))
    options = parser.parse_args()
    rows = [row for name in options.only for row in PARTS[name](options)]
    print(report(rows))
    return 0 if all(row.holds for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
