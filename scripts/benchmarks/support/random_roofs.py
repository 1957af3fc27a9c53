# SPDX-License-Identifier: BSD-3-Clause
"""Halls, cameras and wheels drawn at random, of the seeds that are for judging: nothing is tuned on them."""

from dataclasses import dataclass
from typing import Iterator, List

import numpy as np
from support.table import Row

from ceiling_dso_ros.evaluation.alignment import AlignmentKind
from ceiling_dso_ros.experiments.fused_run import FusedRun
from ceiling_dso_ros.experiments.kept_runs import OdometryRun
from ceiling_dso_ros.experiments.tracked_drives import TrackedDrives
from ceiling_dso_ros.experiments.tracked_run import TrackedRun
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.drawn import draw_config

JUDGING = 100  # first seed
DRIVES = ("loops", "eights", "aisles")
DURATION_S = 60.0
WITH_WHEELS = " with wheels"  # names runs with their prediction
WRONG_S = 0.5  # longest time for which a wrong pose may be called good
MEDIAN_WAY_M, MOST_WAY_M = 0.25, 0.6  # driven until the first pose, in the median and in 95 % of the halls
MEDIAN_PERCENT, MOST_PERCENT = 0.02, 0.06  # of the path
FUSED_PERCENT = 0.04
NEES_FACTOR = 3.0
LOW_RATES, LOW_RATE_HALLS, MOST_RATIO = (6, 3), 10, 2.0


@dataclass(frozen=True)
class JudgedDrive:
    """A drive with the results of the odometry and of the fusion."""

    seed: int
    camera: TrackedRun
    fused: FusedRun

    @property
    def fused_percent(self) -> float:
        """Error of the published pose beyond the mean radius, as a share of the path."""
        return 100.0 * self.fused.ate_m(self.fused.playback.fused(), AlignmentKind.SIM2) / self.fused.path_m


def judged_config(seed: int) -> SimulationConfig:
    """The drive of a seed; different ways in turns."""
    return draw_config(DRIVES[seed % len(DRIVES)], seed, duration_s=DURATION_S)


def judged(tracked: TrackedDrives, seed: int) -> JudgedDrive:
    """Render, track and fuse; what exists already is used."""
    config = judged_config(seed)
    camera = tracked.drive(config, OdometryRun(predict=True), WITH_WHEELS)
    drive = tracked.rendered.drive(config)
    fused = FusedRun(drive.recording, camera.statuses, drive.simulated.camera_truth, drive.simulated.base_truth)
    return JudgedDrive(seed, camera, fused)


def roofs(tracked: TrackedDrives, count: int) -> Iterator[Row]:
    """One drive in each hall."""
    drives = [judged(tracked, seed) for seed in _seeds(count)]
    runs = [drive.camera for drive in drives]
    subject = f"random halls {JUDGING} to {JUDGING + count - 1}"
    yield Row(subject, "longest time beyond 5 sigma, s", [run.longest_wrong_s() for run in runs], WRONG_S)
    yield Row(subject, "the same of the fused pose while good, s", [d.fused.longest_wrong_s() for d in drives], WRONG_S)
    way_m = [drive.fused.way_m(run.first_pose_ns) for drive, run in zip(drives, runs)]
    yield from _median_and_most(subject, "driven before the first pose, m", way_m, MEDIAN_WAY_M, MOST_WAY_M)
    percent = [run.final_ate_percent for run in runs]
    yield from _median_and_most(subject, "final ATE, % of path", percent, MEDIAN_PERCENT, MOST_PERCENT)
    fused = [drive.fused_percent for drive in drives]
    yield from _median_and_most(subject, "fused ATE after Sim(2), % of path", fused, FUSED_PERCENT, np.inf)
    for name, nees in (
        ("pose relative to its keyframe", [run.mean_nees / 6.0 for run in runs]),
        ("fused pose", [drive.fused.mean_nees() / 3.0 for drive in drives]),
    ):
        yield Row(subject, f"mean NEES of the {name}, / expected", nees)
        yield Row(subject, "its mean", [float(np.nanmean(nees))], NEES_FACTOR, 1.0 / NEES_FACTOR)
    yield Row(subject, "times lost", [run.lost for run in runs])
    for drive in drives:
        for loss in drive.camera.losses():
            yield Row(f"hall {drive.seed}", f"lost at {loss}", [1])


def low_rates(tracked: TrackedDrives, count: int) -> Iterator[Row]:
    """The first of these halls with images left out."""
    seeds = _seeds(min(count, LOW_RATE_HALLS))
    drives = [judged_config(seed) for seed in seeds]
    full = [tracked.drive(drive, OdometryRun(predict=True), WITH_WHEELS).final_ate_m for drive in drives]
    for hz in LOW_RATES:
        run = OdometryRun(predict=True, every=30 // hz)
        runs = [tracked.drive(drive, run, f" {hz} Hz{WITH_WHEELS}") for drive in drives]
        subject = f"random halls {seeds[0]} to {seeds[-1]}, {hz} Hz"
        yield Row(subject, "final ATE / that of 30 Hz", [r.final_ate_m / f for r, f in zip(runs, full)], MOST_RATIO)
        yield Row(subject, "times lost", [r.lost for r in runs], 0)


def _seeds(count: int) -> List[int]:
    return list(range(JUDGING, JUDGING + count))


def _median_and_most(subject: str, what: str, values: List[float], median: float, most: float) -> Iterator[Row]:
    yield Row(subject, what, values)
    yield Row(subject, "its median", [float(np.median(values))], median)
    yield Row(subject, "its 95th percentile", [float(np.percentile(values, 95))], most)
