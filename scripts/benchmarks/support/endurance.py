# SPDX-License-Identifier: BSD-3-Clause
"""Half an hour of driving: whether memory or time per image grow.

Times are in the machine's unit of the same minute: a machine that has other work, too, changes its speed within half an
hour.
"""

import json
import time
from array import array
from pathlib import Path
from typing import Dict, Iterator, List

import numpy as np
from support.memory import resident_mb
from support.table import Row
from tqdm import tqdm

from ceiling_dso_ros.dso import DirectOdometry, TrackingState
from ceiling_dso_ros.dso.durations import nanoseconds, seconds
from ceiling_dso_ros.experiments.tracked_drives import TrackedDrives
from ceiling_dso_ros.io.preprocessing import ImagePreprocessor
from ceiling_dso_ros.io.recording import Frame, Recording
from ceiling_dso_ros.playback.machine_speed import machine_ms
from ceiling_dso_ros.simulation.config import SimulationConfig

MINUTES = 30
EARLY, LATE = slice(5, 10), slice(25, 30)  # minutes whose times are compared
IMAGES_A_UNIT, UNIT_RUNS = 60, 3  # the unit is measured after this many images, as the minimum of this many runs


def long(tracked: TrackedDrives, _: int) -> Iterator[Row]:
    """A square that closes, driven again and again: the same images with later stamps."""
    path = tracked.kept.folder / "long_minutes.json"
    if not path.exists():
        _drive_on(tracked.rendered.drive(SimulationConfig("square")).recording, path)
    minutes: Dict[str, List[float]] = json.loads(path.read_text())
    memory_mb, frame_ms, unit_ms = (np.array(minutes[name]) for name in ("memory_mb", "frame_ms", "unit_ms"))
    units = frame_ms / unit_ms
    subject = f"square, {len(frame_ms)} min"
    yield Row(subject, "times lost", [sum(minutes["lost"])], 0)
    yield Row(subject, "memory after minute 5 and at the end, MB", [memory_mb[4], memory_mb[-1]])
    yield Row(subject, "their ratio", [memory_mb[-1] / memory_mb[4]], 1.05)
    yield Row(subject, "CPU ms an image, minutes 6 to 10, 26 to 30", [frame_ms[EARLY].mean(), frame_ms[LATE].mean()])
    yield Row(subject, "the same in units", [units[EARLY].mean(), units[LATE].mean()])
    yield Row(subject, "their ratio", [units[LATE].mean() / units[EARLY].mean()], 1.1)
    yield Row(subject, "CPU time / time driven", [frame_ms.mean() * 30 / 1000], 1.0)


def _drive_on(recording: Recording, out: Path) -> None:
    """Write memory, processor time per image, the machine's unit and losses of each minute."""
    preprocess = ImagePreprocessor(recording.calibration, recording.photometric)
    odometry = DirectOdometry(recording.calibration.camera)
    minutes: Dict[str, List[float]] = {"memory_mb": [], "frame_ms": [], "unit_ms": [], "lost": []}
    times_ms, units_ms, lost = array("d"), array("d"), 0
    for frame in tqdm(_laps(recording), desc="long", unit="frame", disable=None):
        if seconds(frame.stamp_ns) >= 60.0 * (len(minutes["lost"]) + 1):
            minutes["memory_mb"].append(resident_mb())
            minutes["frame_ms"].append(float(np.mean(times_ms)))
            minutes["unit_ms"].append(float(np.mean(units_ms)))
            minutes["lost"].append(float(lost))
            times_ms, units_ms, lost = array("d"), array("d"), 0
            if len(minutes["lost"]) == MINUTES:
                break
        start_s = time.process_time()
        status = odometry.track(preprocess(frame.image), frame.stamp_ns, frame.exposure_ms)
        times_ms.append(1e3 * (time.process_time() - start_s))
        lost += status.state is TrackingState.LOST
        if len(times_ms) % IMAGES_A_UNIT == 0:
            units_ms.append(machine_ms(UNIT_RUNS))
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps(minutes))


def _laps(recording: Recording) -> Iterator[Frame]:
    """The recording without end; stamps count from 0."""
    begin_ns = 0
    while True:
        first_ns = None
        for frame in recording.frames():
            if not isinstance(frame, Frame):
                continue
            first_ns = frame.stamp_ns if first_ns is None else first_ns
            last_ns = begin_ns + frame.stamp_ns - first_ns
            yield Frame(last_ns, frame.exposure_ms, frame.image)
        begin_ns = last_ns + nanoseconds(1.0 / 30.0)
