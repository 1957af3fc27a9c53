# SPDX-License-Identifier: BSD-3-Clause
"""Many starts of the odometry while a cover slides off the lens.

The edge of the cover is blurred because it is near, and it moves independently of the ceiling. Until it is gone the
view is narrow. A wrong first map made from such images stays wrong for its whole segment.
"""

from dataclasses import dataclass, field
from typing import Iterator, List

import numpy as np
from support.table import Row
from tqdm import tqdm

from ceiling_dso_ros.dso import DirectOdometry, OdometryStatus
from ceiling_dso_ros.experiments.rendered_drives import RenderedDrive
from ceiling_dso_ros.experiments.tracked_drives import TrackedDrives
from ceiling_dso_ros.experiments.tracked_run import TrackedRun
from ceiling_dso_ros.io.preprocessing import ImagePreprocessor
from ceiling_dso_ros.io.recording import Frame
from ceiling_dso_ros.simulation.config import SimulationConfig

EVERY, FRAMES = 65, 120  # images from one start to the next, and that each is followed
SLIDING, BLUR = 6, 0.04  # images until the cover is gone; width of its edge, share of the image's
COVER_GREY = 2.0
WORST_PERCENT = 0.5  # of the path: a wrong map has a larger error


@dataclass
class Start:
    """A start of the odometry that is being followed.

    Attributes:
        first: index of its first image in the drive.
        phase: progress of the cover in that image, as a share of its motion per image.
    """

    first: int
    phase: float
    odometry: DirectOdometry
    statuses: List[OdometryStatus] = field(default_factory=list)


def uncovered(tracked: TrackedDrives, count: int) -> Iterator[Row]:
    """Start the odometry many times within loops under the factory roof."""
    drives = [tracked.rendered.drive(SimulationConfig("loops", seed=seed)) for seed in range(count)]
    runs = [run for drive in drives for run in starts_under_cover(drive)]
    subject = f"loops, factory, {len(runs)} starts under a cover"
    posed = [run for run in runs if np.isfinite(run.final_ate_m)]
    yield Row(subject, "without a pose", [len(runs) - len(posed)], 0)
    yield Row(subject, "times lost", [sum(run.lost for run in runs)], 0)
    percent = [run.final_ate_percent for run in posed]
    yield Row(subject, "final ATE, % of path: median, 95 %", np.percentile(percent, (50, 95)))
    yield Row(subject, "final ATE, % of path: worst", [max(percent)], WORST_PERCENT)
    first = [run.first_pose - SLIDING for run in posed]
    yield Row(subject, "images from uncovered to pose: median, worst", [float(np.median(first)), max(first)])


def covered(image: np.ndarray, images: float) -> np.ndarray:
    """An image with a cover that has been sliding off to the right for `images` image intervals."""
    edge = images / SLIDING * (1.0 + 2.0 * BLUR) - BLUR
    visible = np.clip((edge - np.linspace(0.0, 1.0, image.shape[1])) / BLUR + 0.5, 0.0, 1.0)
    return (image * visible + COVER_GREY * (1.0 - visible)).astype(np.float32)


def starts_under_cover(drive: RenderedDrive) -> Iterator[TrackedRun]:
    """One run for every start within a drive."""
    recording = drive.recording
    preprocess = ImagePreprocessor(recording.calibration, recording.photometric)
    phases = np.random.default_rng(0)
    under_way: List[Start] = []
    frames = tqdm(recording.frames(), desc=f"{drive.name}, uncovered", total=len(recording), unit="frame", disable=None)
    for i, frame in enumerate(frames):
        if not isinstance(frame, Frame):
            continue
        if i % EVERY == 0 and i + FRAMES <= len(recording):
            under_way.append(Start(i, phases.uniform(), DirectOdometry(recording.calibration.camera)))
        image = preprocess(frame.image)
        for start in under_way:
            seen = covered(image, i - start.first + start.phase)
            start.statuses.append(start.odometry.track(seen, frame.stamp_ns, frame.exposure_ms))
        for start in [start for start in under_way if len(start.statuses) == FRAMES]:
            under_way.remove(start)
            yield TrackedRun(start.statuses, drive.simulated.camera_truth)
