# SPDX-License-Identifier: BSD-3-Clause
"""What is played, dropped and measured, on a clock of its own."""

import numpy as np
import pytest

from ceiling_dso_ros.dso.status import OdometryStatus, TrackingState
from ceiling_dso_ros.io.recording import Frame
from ceiling_dso_ros.playback.live_benchmark import describe, play_live


class Clock:
    def __init__(self):
        self.now_s = 100.0

    def __call__(self):
        return self.now_s

    def sleep(self, seconds):
        assert seconds >= 0
        self.now_s += seconds


def play(work_s, rate=1.0, count=10, state=TrackingState.TRACKING):
    """Ten images a second; an image takes work_s(index) seconds."""
    clock, seen = Clock(), []

    def track(frame):
        seen.append(frame.stamp_ns // 100_000_000)
        clock.sleep(work_s(seen[-1]))
        timing_ms = {"track": 20.0, "pyramid": 5.0, "optimize": 40.0, "trace": 10.0}
        return OdometryStatus(frame.stamp_ns, state, 0, timing_ms=timing_ms)

    frames = [Frame(100_000_000 * k, None, np.zeros((2, 2), np.uint8)) for k in range(count)]
    return play_live(frames, track, rate, clock, clock.sleep), seen


def test_who_is_fast_enough_drops_nothing():
    run, seen = play(lambda index: 0.03)
    assert seen == list(range(10))
    summary = run.summary()
    assert summary["dropped"] == 0
    assert summary["latency_ms"]["median"] == pytest.approx(30.0)
    assert summary["mean_ms"] == pytest.approx({"tracking": 25.0, "mapping": 50.0})
    assert summary["speed_factor"] == pytest.approx(2.0)  # 50 ms of mapping in 100 ms


def test_the_newest_image_wins():
    run, seen = play(lambda index: 0.25 if index == 2 else 0.03)
    assert seen == [0, 1, 2, 4, 5, 6, 7, 8, 9]
    assert run.dropped == 1
    assert run.latencies_ms[2] == pytest.approx(250.0)
    assert run.latencies_ms[3] == pytest.approx(80.0)  # due at 0.4 s, taken at 0.45 s


def test_a_higher_rate_leaves_less_time():
    assert play(lambda index: 0.06, rate=2.0)[0].dropped > 0
    assert play(lambda index: 0.04, rate=2.0)[0].dropped == 0


def test_the_making_of_the_first_map_may_take_its_time():
    run, seen = play(lambda index: 0.25 if index == 0 else 0.03)
    assert seen == [0, 2, 3, 4, 5, 6, 7, 8, 9]
    assert run.dropped == 0


def test_what_is_dropped_before_the_first_pose_is_not_counted():
    run, seen = play(lambda index: 0.25, state=TrackingState.INITIALIZING)
    assert len(seen) < 10
    summary = run.summary()
    assert summary["dropped"] == 0
    assert summary["tracked"] == 0
    assert summary["latency_ms"] == {"median": None, "p95": None}
    assert "-" in describe(summary)
