# SPDX-License-Identifier: BSD-3-Clause
"""Plays a recording in real time or faster, like a camera, and measures whether the odometry is fast enough."""

import time
from dataclasses import dataclass
from typing import Any, Callable, Dict, List, Sequence

import numpy as np
from tabulate import tabulate

from ceiling_dso_ros.dso import OdometryStatus, TrackingState
from ceiling_dso_ros.dso.durations import seconds
from ceiling_dso_ros.io.recording import Frame

TRACKING_STAGES = ("undistort", "pyramid", "initialize", "track")  # the rest is the mapping's


@dataclass(frozen=True)
class LiveRun:
    """Results for the images that were not dropped.

    Attributes:
        statuses: of the images, in their order.
        latencies_ms: (images,) from an image's time to its pose.
        dropped: images replaced by a newer one before the odometry was ready, counted after the image with the first
            pose.
        frame_rate_hz: of the recording.
    """

    statuses: Sequence[OdometryStatus]
    latencies_ms: np.ndarray
    dropped: int
    frame_rate_hz: float

    def summary(self) -> Dict[str, Any]:
        """Counts, latencies and mean times; the speed factor is 1 / (t f) with t of the thread that takes longer."""
        tracking = [status.state is TrackingState.TRACKING for status in self.statuses]
        latencies_ms = self.latencies_ms[tracking]
        stages = {"tracking": 0.0, "mapping": 0.0}
        for status, tracked in zip(self.statuses, tracking):
            for stage, milliseconds in status.timing_ms.items():
                if tracked:
                    stages["tracking" if stage in TRACKING_STAGES else "mapping"] += milliseconds / sum(tracking)
        busiest_ms = max(stages.values())
        return {
            "images": len(self.statuses),
            "tracked": sum(tracking),
            "lost": sum(status.state is TrackingState.LOST for status in self.statuses),
            "dropped": self.dropped,
            "latency_ms": {
                "median": float(np.median(latencies_ms)) if any(tracking) else None,
                "p95": float(np.percentile(latencies_ms, 95)) if any(tracking) else None,
            },
            "mean_ms": stages,
            "speed_factor": 1e3 / (self.frame_rate_hz * busiest_ms) if busiest_ms > 0 else None,
        }


def play_live(
    frames: Sequence[Frame], track: Callable[[Frame], OdometryStatus], rate: float,
    clock: Callable[[], float] = time.perf_counter, sleep: Callable[[float], None] = time.sleep,
) -> LiveRun:  # fmt: skip
    """Give every frame to `track` at its time; if several are due, the newest one, and the others are dropped.

    Args:
        frames: two or more, in the order of time.
        rate: playback speed, 1 for real time.
        clock, sleep: seconds.
    """
    due_s = np.array([seconds(frame.stamp_ns - frames[0].stamp_ns) for frame in frames]) / rate + clock()
    statuses: List[OdometryStatus] = []
    latencies_s: List[float] = []
    dropped, index = 0, 0
    while index < len(frames):
        sleep(max(due_s[index] - clock(), 0.0))
        newest = max(int(np.searchsorted(due_s, clock(), side="right")) - 1, index)
        if [status.state for status in statuses[-2:]] == 2 * [TrackingState.TRACKING]:  # the first makes a map
            dropped += newest - index
        statuses.append(track(frames[newest]))
        latencies_s.append(clock() - due_s[newest])
        index = newest + 1
    interval_ns = np.median(np.diff([frame.stamp_ns for frame in frames]))
    return LiveRun(statuses, 1e3 * np.array(latencies_s), dropped, 1.0 / seconds(float(interval_ns)))


def describe(summary: Dict[str, Any]) -> str:
    """A table of one line for each figure."""
    latency, mean = summary["latency_ms"], summary["mean_ms"]
    rows = [
        ("images", summary["images"]),
        ("with a pose", summary["tracked"]),
        ("lost", summary["lost"]),
        ("dropped while tracking", summary["dropped"]),
        ("latency, median (ms)", latency["median"]),
        ("latency, 95th percentile (ms)", latency["p95"]),
        ("tracking, mean of an image (ms)", mean["tracking"]),
        ("mapping, mean of an image (ms)", mean["mapping"]),
        ("speed factor", summary["speed_factor"]),
    ]
    return tabulate(rows, floatfmt=".2f", missingval="-")
