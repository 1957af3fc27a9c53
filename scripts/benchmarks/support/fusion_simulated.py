# SPDX-License-Identifier: BSD-3-Clause
"""Parts of the fusion's benchmark without images: simulated trajectories, and real wheels."""

import sys
import time
from pathlib import Path
from typing import Iterator, List, Tuple

import numpy as np
from scipy.stats import chi2
from support.memory import resident_mb
from support.table import Row
from tqdm import tqdm

from ceiling_dso_ros.dso.durations import seconds
from ceiling_dso_ros.experiments.kept_runs import Kept, is_missing
from ceiling_dso_ros.fusion.estimator import FusionEstimator

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "test" / "fusion"))

import lecture_hall
from fused_drive import drawn_runs
from simulated_drive import simulate_drive

RUNS, RUN_S = 50, 30.0
BLIND = ((20.0, 25.0),)  # of those runs that are without camera for a while
MINUTES = 30.0


def consistency(_: Kept, __: int) -> Iterator[Row]:
    """Whether the errors of many runs agree with their covariances, also after a time without camera."""
    for subject, losses in ((f"{RUNS} runs", ()), (f"{RUNS} runs, blind for 5 s", BLIND)):
        runs = drawn_runs(RUNS, RUN_S, losses)
        runs = list(tqdm(runs, total=RUNS, desc="consistency", unit="run", disable=None))
        pose = np.mean([error @ np.linalg.solve(covariance, error) for error, covariance, _, _ in runs])
        scale = np.mean([(error / sigma) ** 2 for _, _, error, sigma in runs])
        for name, nees, dimensions in (("x, y, yaw", pose, 3), ("log-scale", scale, 1)):
            low, high = chi2.ppf([0.025, 0.975], RUNS * dimensions) / RUNS
            yield Row(subject, f"mean NEES of {name}", [nees], high, low)


def timing(_: Kept, __: int) -> Iterator[Row]:
    """Half an hour of driving: how long graph updates take, and how much memory they keep."""
    updates_ms, memory_mb = _half_an_hour()
    third = len(updates_ms) // 3
    first, last = np.percentile(updates_ms[:third], 99), np.percentile(updates_ms[-third:], 99)
    subject = f"{MINUTES:.0f} min, {len(updates_ms)} updates"
    yield Row(subject, "graph update, 99th percentile, ms", [np.percentile(updates_ms, 99)], 30.0)
    yield Row(subject, "last third / first third of the time", [last / first], 1.2)
    yield Row(subject, "memory gained in the last 20 min, MB", [memory_mb[-1] - memory_mb[len(memory_mb) // 3]], 2.0)


def _half_an_hour() -> Tuple[np.ndarray, List[float]]:
    """Processor time of the wheel samples with a graph update and the images before, ms; memory each minute, MB."""
    drive = simulate_drive("loops", 60.0 * MINUTES)
    estimator = FusionEstimator(drive.robot)
    updates_ms: List[float] = []
    memory_mb: List[float] = []
    took_s, estimate = 0.0, None
    for stamp_ns, is_camera, data in tqdm(drive.events(), desc="timing", unit="event", disable=None):
        if seconds(stamp_ns - drive.stamps[0]) >= 60.0 * len(memory_mb):
            memory_mb.append(resident_mb())
        start_s = time.process_time()
        if is_camera:
            estimator.add_keyframes(data)
            estimator.add_frame(data)
        else:
            estimator.add_wheel_ticks(stamp_ns, *data)
        took_s += time.process_time() - start_s
        if estimator.newest_keyframe is not estimate:
            estimate = estimator.newest_keyframe
            updates_ms.append(1e3 * took_s)
        if not is_camera:
            took_s = 0.0
    return np.array(updates_ms), memory_mb


def wheels_lecture_hall(_: Kept, __: int) -> Iterator[Row]:
    """Real dead reckoning over 733 m with the noise setting that docs/fusion.md documents."""
    if is_missing(lecture_hall.FOLDER):
        return
    within = (np.abs(lecture_hall.normalised_errors()) < 3.0).all(axis=1)
    yield Row("wheels_lecture_hall", "x, y and yaw all within 3 sigma, % of the time", [100 * within.mean()], low=95.0)


PARTS = (consistency, timing, wheels_lecture_hall)
