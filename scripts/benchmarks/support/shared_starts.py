# SPDX-License-Identifier: BSD-3-Clause
"""The shared recordings from their first image on, and the simulator's own drives beside the reference's results."""

import json
from typing import Iterator, List

import numpy as np
from support.checkout import DATA
from support.table import Row

from ceiling_dso_ros.evaluation.alignment import AlignmentKind
from ceiling_dso_ros.experiments.fused_run import FusedRun
from ceiling_dso_ros.experiments.kept_runs import OdometryRun, is_missing
from ceiling_dso_ros.experiments.tracked_drives import TrackedDrives
from ceiling_dso_ros.experiments.tracked_run import TrackedRun
from ceiling_dso_ros.io.opening import open_recording
from ceiling_dso_ros.io.trajectory import read_tum
from ceiling_dso_ros.simulation.config import SimulationConfig

START, HARD = "ceiling_start", "ceiling_hard"
# Of ceiling_start: one of so many images, seconds until the first pose, final error in millimetres.
FIRST_POSES = ((1, 80 / 30.0, 1.6), (5, 3.6, 2.5), (10, 4.0, 2.5))
HARD_STARTS = (0, 8, 16, 24, 32, 40)
HARD_MM, HARD_WITHOUT_EXPOSURES_MM, HARD_FUSED_MM = 7.5, 6.5, 8.0
MOST_MEAN_RATIO, MOST_RATIO = 0.55, 0.85


def first_poses(tracked: TrackedDrives, _: int) -> Iterator[Row]:
    """How soon and how well the odometry begins, with the wheels' prediction, on all images and on some of them."""
    if is_missing(DATA / START):
        return
    for every, latest_s, most_mm in FIRST_POSES:
        run = tracked.shared(START, OdometryRun(every=every, predict=True), f" every {every}")
        subject = f"{START}, 1 of {every} images"
        yield Row(subject, "first pose after the first image, s", [run.first_pose_s], latest_s)
        yield Row(subject, "final ATE, truth at the stamps, mm", [1e3 * run.final_ate_m], most_mm)
        yield Row(subject, "times lost", [run.lost], 0)


def hard(tracked: TrackedDrives, _: int) -> Iterator[Row]:
    """The recording of another renderer from several first images on, with and without exposure times."""
    if is_missing(DATA / HARD):
        return
    for told, most_mm in ((True, HARD_MM), (False, HARD_WITHOUT_EXPOSURES_MM)):
        runs = [_hard(tracked, first, told) for first in HARD_STARTS]
        subject = f"{HARD}, exposures {'known' if told else 'unknown'}, from images {', '.join(map(str, HARD_STARTS))}"
        final_mm = [1e3 * run.final_ate_m for run in runs]
        yield Row(subject, "final ATE, truth at the stamps, mm", final_mm)
        yield Row(subject, "from the first image", final_mm[:1], most_mm)
        yield Row(subject, "its median", [float(np.median(final_mm))], most_mm)
        yield Row(subject, "times lost", [run.lost for run in runs], 0)
        yield Row(subject, "fused after Sim(2), mm", [1e3 * _fused_m(runs[0])], HARD_FUSED_MM)


def _hard(tracked: TrackedDrives, first: int, told: bool) -> TrackedRun:
    run = OdometryRun(first=first, predict=True, exposures_told=told)
    return tracked.shared(HARD, run, f" from {first}{'' if told else ' without exposures'}")


def _fused_m(run: TrackedRun) -> float:
    folder = DATA / HARD
    truths = read_tum(folder / "groundtruth.tum"), read_tum(folder / "groundtruth_base.tum")
    fused = FusedRun(open_recording(folder), run.statuses, *truths)
    return fused.ate_m(fused.playback.fused(), AlignmentKind.SIM2)


def reference_drives(tracked: TrackedDrives, _: int) -> Iterator[Row]:
    """Whole laps under the simulator's own roofs, as the reference has tracked them."""
    path = DATA / "reference_drives.json"
    if is_missing(DATA) or not path.is_file():
        return
    ratios: List[float] = []
    for theirs in json.loads(path.read_text())["drives"]:
        config = SimulationConfig(theirs["sequence"], theirs["ceiling"], theirs["seed"])
        run = tracked.drive(config, OdometryRun(predict=True), " with wheels")
        ratios.append(run.final_ate_m / theirs["ate_final_m"])
        subject = f"{config.sequence}, {config.ceiling}, seed {config.seed}"
        yield Row(subject, "final ATE / the reference's", ratios[-1:], MOST_RATIO)
        yield Row(subject, "keyframes, the reference's", [run.keyframes, theirs["keyframes"]])
    yield Row(
        f"{len(ratios)} drives", "geometric mean of the ratios", [np.exp(np.mean(np.log(ratios)))], MOST_MEAN_RATIO
    )
