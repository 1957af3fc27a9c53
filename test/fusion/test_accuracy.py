# SPDX-License-Identifier: BSD-3-Clause
"""What the fusion promises, on simulated drives with a visual odometry that errs 1 mm and 0.02 degrees a keyframe."""

import dataclasses

import numpy as np
import pytest

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.durations import seconds
from ceiling_dso_ros.fusion.state import FusionState

pytestmark = pytest.mark.long
SEEDS = range(5)
SECONDS = {"square": 74.0, "loops": 60.0}


@pytest.fixture
def robot_truth(truth):
    """1 % of ratio and base, noisy encoders, exact mean radius, a poor camera."""
    return truth(ratio=0.01, base=0.01, wheel_noise=0.002, shift_sigma=2.2e-4, turn_sigma=3.5e-4)


@pytest.mark.parametrize("sequence", ["square", "loops"])
@pytest.mark.parametrize("seed", SEEDS)
def test_metric_and_far_better_than_wheels(simulate, fuse, robot_truth, sequence, seed):
    fused = fuse(simulate(sequence, SECONDS[sequence], seed, robot_truth))
    path = fused.drive.path_m
    wheels = fused.ate(fused.stamps, fused.wheel_poses)
    live = fused.ate(fused.stamps, fused.poses)
    nodes = fused.estimator.smoothed()
    smoothed = fused.ate([node.stamp_ns for node in nodes], [node.pose for node in nodes])
    assert abs(fused.scale_error(after_m=5.0)) < 0.005
    assert abs(fused.scale_error()) < 0.002
    assert live < 0.003 * path
    assert live < wheels / 5.0
    assert smoothed < 0.002 * path
    assert fused.estimator.slips == []


@pytest.mark.parametrize("seed", SEEDS)
def test_three_slips(simulate, fuse, robot_truth, seed):
    slips = ((15.0, 15.5), (30.0, 30.5), (45.0, 45.5))
    fused = fuse(simulate("loops", SECONDS["loops"], seed, dataclasses.replace(robot_truth, slips=slips)))
    live = fused.ate(fused.stamps, fused.poses)
    assert live < 0.005 * fused.drive.path_m
    assert live < fused.ate(fused.stamps, fused.wheel_poses) / 10.0
    begin = fused.drive.stamps[0]
    assert len(fused.estimator.slips) == len(slips)
    for report, (start_s, end_s) in zip(fused.estimator.slips, slips):
        assert abs(seconds(report.start_ns - begin) - start_s) < 0.3
        assert abs(seconds(report.end_ns - begin) - end_s) < 0.3


@pytest.mark.parametrize("seed", SEEDS)
def test_a_lens_covered_for_five_seconds(simulate, fuse, robot_truth, seed):
    covered = dataclasses.replace(robot_truth, losses=((25.0, 30.0),))
    drive = simulate("loops", SECONDS["loops"], seed, covered)
    fused = fuse(drive)
    clear = fuse(simulate("loops", SECONDS["loops"], seed, robot_truth))
    states = {s.state for s in fused.states if 25.1 < seconds(s.stamp_ns - drive.stamps[0]) < 29.9}
    assert states == {FusionState.DEGRADED}
    added = np.hypot(*(fused.poses[-1] - clear.poses[-1])[:2])
    first, last = np.searchsorted(fused.times_s, [25.0, 30.0])
    start, end, finish = fused.truth(fused.stamps[[first, last, -1]])
    drifted = planar.compose(start, planar.between(*fused.wheel_poses[[first, last]]))
    assert added < np.hypot(*(planar.compose(drifted, planar.between(end, finish)) - finish)[:2])


def test_ten_minutes_without_slip_have_at_most_one_false_report(simulate, fuse, robot_truth):
    fused = fuse(simulate("loops", 600.0, 11, robot_truth), keep_history=False)
    assert len(fused.estimator.slips) <= 1
    assert fused.ate(fused.stamps, fused.poses) < 0.003 * fused.drive.path_m


def test_what_it_remembers_does_not_grow(simulate, fuse, robot_truth):
    estimator = fuse(simulate("loops", 120.0, 12, robot_truth), keep_history=False).estimator
    backend = estimator._backend
    assert len(backend._graph.intervals) == estimator.config.graph.window
    assert backend._graph.history is None
    assert backend._graph._values.size() <= 2 * (estimator.config.graph.window + 1)
    assert len(estimator._waiting) <= 2
    assert len(estimator._frames) <= 60
    assert len(estimator._track.steps(0, 2**62)) <= 502
