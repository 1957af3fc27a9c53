# SPDX-License-Identifier: BSD-3-Clause
"""Images left out while hardly anything moves, against all images and against half of them, under random roofs."""

from typing import Dict, Iterator, List

import numpy as np
from support.table import Row

from ceiling_dso_ros.evaluation.association import interpolate_poses
from ceiling_dso_ros.experiments.fused_run import FusedRun
from ceiling_dso_ros.experiments.kept_runs import OdometryRun
from ceiling_dso_ros.experiments.tracked_drives import TrackedDrives
from ceiling_dso_ros.experiments.tracked_run import TrackedRun
from ceiling_dso_ros.playback.frame_regulation import SETTLING_S
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.drawn import draw_camera, draw_config

SEQUENCES = ("square", "loops", "stop_and_go")
SIZE = {"width": 424, "height": 240}
RUNS: Dict[str, OdometryRun] = {
    "30 Hz": OdometryRun(predict=True),
    "15 Hz": OdometryRun(predict=True, every=2),
    "auto": OdometryRun(predict=True, regulated=True),
}
MOST_ERROR, MOST_IMAGES, MOST_STANDING = 1.05, 0.5, 0.1  # shares of those of 30 Hz
STANDS_M_S, STANDS_RAD_S = 0.01, 0.01
HALF_S = 0.1  # around an image: over twice this time its motion is measured, because the base vibrates


def regulation(tracked: TrackedDrives, count: int) -> Iterator[Row]:
    """Each drive with all images, with half of them, and with those that its motion needs."""
    for sequence in SEQUENCES:
        drives = [draw_config(sequence, seed, camera=draw_camera(seed, **SIZE)) for seed in range(count)]
        runs = {name: [_tracked(tracked, drive, name) for drive in drives] for name in RUNS}
        fused_m = {name: [_fused_m(tracked, *pair) for pair in zip(drives, runs[name])] for name in RUNS}
        final_m = {name: [run.final_ate_m for run in runs[name]] for name in RUNS}
        share = np.divide([len(run.statuses) for run in runs["auto"]], [len(run.statuses) for run in runs["30 Hz"]])
        cpu = np.divide([_cpu_ms(run) for run in runs["auto"]], [_cpu_ms(run) for run in runs["30 Hz"]])
        halved = np.divide([_cpu_ms(run) for run in runs["15 Hz"]], [_cpu_ms(run) for run in runs["30 Hz"]])
        subject = f"{sequence}, random"
        yield Row(subject, "images used, share", share, MOST_IMAGES)
        standing = [_standing_share(tracked, *each) for each in zip(drives, runs["30 Hz"], runs["auto"])]
        yield Row(subject, "while standing", [value for value in standing if np.isfinite(value)], MOST_STANDING)
        for what, error_m in (("final ATE", final_m), ("fused ATE", fused_m)):
            yield Row(subject, f"{what} at 30 Hz, mm", 1e3 * np.array(error_m["30 Hz"]))
            yield Row(subject, f"{what} / that of 30 Hz", np.divide(error_m["auto"], error_m["30 Hz"]), MOST_ERROR)
            yield Row(subject, f"{what} of 15 Hz / that of 30 Hz", np.divide(error_m["15 Hz"], error_m["30 Hz"]))
            yield Row(subject, f"{what} / that of 15 Hz", np.divide(error_m["auto"], error_m["15 Hz"]), 1.0)
        for name, of_name in runs.items():
            yield Row(subject, f"times lost, {name}", [run.lost for run in of_name], 0)
        yield Row(subject, "time of the odometry, share", cpu)
        yield Row(subject, "time of the odometry at 15 Hz, share", halved)


def _tracked(tracked: TrackedDrives, config: SimulationConfig, name: str) -> TrackedRun:
    return tracked.drive(config, RUNS[name], f" {name}")


def _fused_m(tracked: TrackedDrives, config: SimulationConfig, run: TrackedRun) -> float:
    """Error of what the fusion published, at every wheel sample, of the images that were used or left out alike."""
    drive = tracked.rendered.drive(config)
    fused = FusedRun(drive.recording, run.statuses, drive.simulated.camera_truth, drive.simulated.base_truth)
    return fused.ate_m(fused.playback.fused())


def _cpu_ms(run: TrackedRun) -> float:
    """Time of preprocessing and odometry, without reading and decoding."""
    return sum(sum(status.timing_ms.values()) for status in run.statuses)


def _standing_share(tracked: TrackedDrives, config: SimulationConfig, full: TrackedRun, auto: TrackedRun) -> float:
    """Of the images while the base stands, with a map that is not new; nan where it never does."""
    truth = tracked.rendered.drive(config).simulated.base_truth
    begin_ns = full.statuses[full.first_pose].stamp_ns + round((SETTLING_S + 2.0 * HALF_S) * 1e9)
    stamps_ns = np.array([status.stamp_ns for status in full.statuses], np.int64)
    before, after = (
        interpolate_poses(
            truth.stamps_ns, truth.matrices(), np.clip(stamps_ns + side, truth.stamps_ns[0], truth.stamps_ns[-1])
        )
        for side in (-round(HALF_S * 1e9), round(HALF_S * 1e9))
    )
    way_m = np.linalg.norm(after[:, :2, 3] - before[:, :2, 3], axis=1)
    turn_rad = np.linalg.norm(after[:, :2, 0] - before[:, :2, 0], axis=1)
    stands = (way_m < 2.0 * HALF_S * STANDS_M_S) & (turn_rad < 2.0 * HALF_S * STANDS_RAD_S) & (stamps_ns >= begin_ns)
    standing: List[int] = stamps_ns[stands].tolist()
    used = {status.stamp_ns for status in auto.statuses}
    return sum(stamp_ns in used for stamp_ns in standing) / len(standing) if standing else np.nan
