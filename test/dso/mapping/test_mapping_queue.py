# SPDX-License-Identifier: BSD-3-Clause
"""Frames on their way into the map: what comes back, in which order, and what failures leave behind."""

import threading

import numpy as np
import pytest

from ceiling_dso_ros.dso.compute.schedulers import LiveScheduler, SequentialScheduler
from ceiling_dso_ros.dso.compute.stage_timer import StageTimer
from ceiling_dso_ros.dso.images.frame import Frame
from ceiling_dso_ros.dso.mapping.mapping_queue import MAX_BACKLOG, MappingQueue
from ceiling_dso_ros.dso.status import TrackingLostError


class FakeMapper:
    """Remembers what it was given; makes a snapshot of every keyframe, or fails at a given one."""

    def __init__(self, fails_at=None):
        self.traced, self.fails_at, self.go_on = [], fails_at, threading.Event()
        self.go_on.set()

    def pose_of(self, keyframe_id):
        return np.diag([1.0, 1.0, 1.0, 1.0]) + keyframe_id * np.eye(4, k=3)

    def trace(self, frame):
        self.go_on.wait()
        self.traced.append(frame)

    def add_keyframe(self, frame, timer):
        if frame.stamp_ns == self.fails_at:
            raise TrackingLostError("no solution")
        return f"map of {frame.stamp_ns}"


class FakePool:
    def __init__(self):
        self.released = []

    def release(self, slot):
        self.released.append(slot)


def frame(k):
    return Frame(k, 1.0, k, np.eye(4), np.zeros(2))


def queue(mapper, scheduler=None):
    pool = FakePool()
    return MappingQueue(mapper, pool, scheduler or SequentialScheduler()), pool


def test_a_keyframe_is_pending_until_its_map_is_taken_in():
    mapping, pool = queue(FakeMapper())
    mapping.hand_over(frame(1), 5, np.eye(4), is_keyframe=True)
    assert mapping.keyframe_pending
    assert mapping.map is None
    timer = StageTimer()
    assert mapping.take_in(timer)
    assert not mapping.keyframe_pending
    assert mapping.map == "map of 1"
    assert "trace" in timer.timing_ms
    assert not mapping.take_in(timer)
    assert pool.released == []


def test_a_frame_is_placed_on_its_keyframe_as_that_is_now():
    mapper = FakeMapper()
    mapping, pool = queue(mapper)
    T_frame_keyframe = np.diag([1.0, -1.0, -1.0, 1.0])
    mapping.hand_over(frame(4), 5, T_frame_keyframe, is_keyframe=False)
    np.testing.assert_array_equal(mapper.traced[0].T_camera_world, T_frame_keyframe @ mapper.pose_of(5))
    assert pool.released == [4]


def test_news_are_told_once():
    mapping, _ = queue(FakeMapper())
    for k in (1, 2):
        mapping.hand_over(frame(k), 0, np.eye(4), is_keyframe=True)
    mapping.take_in(StageTimer())
    assert mapping.take_news() == ["map of 1", "map of 2"]
    assert mapping.take_news() == []
    assert mapping.map == "map of 2"


def test_a_failure_is_raised_after_what_was_finished_before_it():
    mapping, _ = queue(FakeMapper(fails_at=2))
    for k in (1, 2):
        mapping.hand_over(frame(k), 0, np.eye(4), is_keyframe=True)
    mapping.take_in(StageTimer())
    assert mapping.take_news() == ["map of 1"]
    with pytest.raises(TrackingLostError, match="no solution"):
        mapping.take_in(StageTimer())


def test_a_mapping_far_behind_is_given_keyframes_only():
    mapper, scheduler = FakeMapper(), LiveScheduler()
    mapping, pool = queue(mapper, scheduler)
    mapper.go_on.clear()
    for k in range(MAX_BACKLOG + 3):
        mapping.hand_over(frame(k), 0, np.eye(4), is_keyframe=False)
    assert pool.released == [MAX_BACKLOG, MAX_BACKLOG + 1, MAX_BACKLOG + 2]
    mapping.hand_over(frame(99), 0, np.eye(4), is_keyframe=True)
    mapper.go_on.set()
    scheduler.wait()
    assert [traced.stamp_ns for traced in mapper.traced] == [*range(MAX_BACKLOG), 99]
    mapping.take_in(StageTimer())
    assert mapping.map == "map of 99"
    scheduler.close()
