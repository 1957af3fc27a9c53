# SPDX-License-Identifier: BSD-3-Clause
"""The odometry while its mapping is behind the tracking: nothing that the mapping found is lost."""

import threading
from concurrent.futures import wait

import numpy as np
import pytest
from flying import CONFIG, FRAME_NS, FRAMES, ate, pose, run, tracking
from synthetic import CAMERA

from ceiling_dso_ros.dso import DirectOdometry, HostedPoints, TrackingState
from ceiling_dso_ros.dso.compute.schedulers import LiveScheduler, SequentialScheduler


class HeldScheduler(LiveScheduler):
    """Lets every task wait until a number of frames have come after it: a mapping that is always behind."""

    def __init__(self, frames):
        super().__init__()
        self._frames, self._held = frames, []

    def submit(self, task):
        ready = threading.Event()
        self._held.append(ready)
        super().submit(lambda: ready.wait() and task())
        for event in self._held[: -self._frames]:
            event.set()
        if len(self._held) > self._frames:  # so that the outcome does not depend on the machine
            wait(list(self._futures)[: -self._frames])

    def wait(self):
        for event in self._held:
            event.set()
        super().wait()


@pytest.mark.parametrize("frames_behind", [1, 3])
def test_tracking_goes_on_while_the_mapping_is_behind(images, frames_behind):
    scheduler = HeldScheduler(frames_behind)
    odometry = DirectOdometry(CAMERA, CONFIG, scheduler)
    statuses = run(odometry, images)
    found = tracking(statuses)
    assert sum(found) > 0.7 * FRAMES
    assert all(found[found.index(True) :])
    assert ate(statuses, [pose(k) for k in range(FRAMES)]) < 0.01
    known = {}
    for status in statuses[found.index(True) :]:
        known.update({keyframe.keyframe_id: keyframe.stamp_ns for keyframe in status.keyframes})
        assert status.keyframe_id in known  # relative to a keyframe that has been described
        assert known[status.keyframe_id] <= status.stamp_ns
    late = [status for status in statuses if status.keyframes and not status.is_keyframe]
    assert len(late) >= 3
    assert all(status.keyframes[-1].stamp_ns < status.stamp_ns for status in late)
    odometry.reset()
    scheduler.close()


def test_images_that_come_all_at_once_wait_for_the_map(images):
    """The mapping does nothing until it is waited for: so no keyframe comes by itself while the images pour in."""
    scheduler = HeldScheduler(10**6)
    odometry = DirectOdometry(CAMERA, CONFIG, scheduler)
    statuses = run(odometry, images)
    found = tracking(statuses)
    assert all(found[found.index(True) :])
    assert sum(status.is_keyframe for status in statuses) > 5
    assert ate(statuses, [pose(k) for k in range(FRAMES)]) < 0.01
    odometry.reset()
    scheduler.close()


def test_the_last_window_of_a_lost_segment_is_told_though_the_mapping_was_behind(images):
    scheduler = HeldScheduler(3)
    odometry = DirectOdometry(CAMERA, CONFIG, scheduler)
    for k, image in enumerate(images):
        if odometry.track(image, k * FRAME_NS).is_keyframe and k > 30:
            break
    odometry.track(np.zeros_like(images[0]), (k + 1) * FRAME_NS)
    lost = odometry.track(np.ones_like(images[0]), (k + 40) * FRAME_NS)
    assert (lost.state, lost.segment) == (TrackingState.LOST, 0)
    assert odometry.map is None
    assert lost.keyframes[-1].stamp_ns == k * FRAME_NS
    assert len(lost.window_points) > 100
    assert set(lost.window_points.keyframe_id.tolist()) <= {e.keyframe_id for e in lost.keyframes if not e.leaves}
    scheduler.close()


class WithheldScheduler(SequentialScheduler):
    """Withholds some tasks' results, from that of the sixth keyframe on, and then gives them with the next ones."""

    def __init__(self, tasks):
        super().__init__()
        self._tasks, self._withheld, self.snapshots = tasks, [], []

    def take_results(self):
        results = super().take_results()
        self.snapshots += [result.snapshot for result in results if result.snapshot is not None]
        if len(self.snapshots) < 6 or self._tasks <= 0:
            results, self._withheld = self._withheld + results, []
            return results
        self._withheld += results
        self._tasks -= len(results)
        return []


@pytest.mark.long
def test_keyframes_that_are_finished_between_two_statuses_are_both_told(images):
    scheduler = WithheldScheduler(tasks=12)
    statuses = run(DirectOdometry(CAMERA, CONFIG, scheduler), images)
    told = [status for status in statuses if status.keyframes]
    assert len(told) == len(scheduler.snapshots) - 1  # one of them has two
    left = HostedPoints.concatenated([status.marginalized for status in told])
    expected = HostedPoints.concatenated([snapshot.marginalized for snapshot in scheduler.snapshots])
    assert len(left) > 100
    np.testing.assert_array_equal(left.position_camera, expected.position_camera)
    last = {e.keyframe_id: e for status in told for e in status.keyframes}
    for estimate in (e for snapshot in scheduler.snapshots for e in snapshot.keyframes if e.leaves):
        assert last[estimate.keyframe_id] is estimate
    windows = {snapshot.stamp_ns: snapshot.window_points for snapshot in scheduler.snapshots}
    for status in told:
        assert status.window_points is windows[status.keyframes[-1].stamp_ns]
        assert [e.keyframe_id for e in status.keyframes] == sorted(e.keyframe_id for e in status.keyframes)
