# SPDX-License-Identifier: BSD-3-Clause
"""What the fusion promises, on simulated drives with a visual odometry that errs 1 mm and 0.02 degrees a keyframe."""

import dataclasses

import pytest

from ceiling_dso_ros.dso.durations import seconds

pytestmark = pytest.mark.long
SEEDS = range(5)
SECONDS = {"square": 74.0, "loops": 60.0}


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
