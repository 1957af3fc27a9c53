# SPDX-License-Identifier: BSD-3-Clause
from dataclasses import fields, replace

import gtsam
import numpy as np
import pytest
from gtsam_solution import solved, whole_graph
from winding_chain import NOISE, SCALE, chain, config

from ceiling_dso_ros.fusion import factors, planar
from ceiling_dso_ros.fusion.config import FusionConfig, GraphConfig
from ceiling_dso_ros.fusion.graph import FactorBuilder, WindowGraph
from ceiling_dso_ros.fusion.motion import MOTION
from ceiling_dso_ros.fusion.smoothing import smooth


def measured(intervals, settings=config()):
    builder = FactorBuilder(settings, NOISE)
    return np.array([builder.motion(interval, np.zeros(3)) for interval in intervals], MOTION)


def an_eventful_drive(count, seed):
    """Noise, wrong motions of the camera, none, slips, and a second segment."""
    rng = np.random.default_rng(seed)
    intervals, _ = chain(count, rng, segment_at=count // 2)
    for index in range(12, count, 37):
        visual = intervals[index].visual
        intervals[index] = replace(
            intervals[index], visual=replace(visual, shift=visual.shift + rng.normal(size=2) / 50)
        )
    for index in range(30, count, 41):
        intervals[index] = replace(intervals[index], visual=None)
    for index in range(31, count, 43):
        intervals[index] = replace(intervals[index], wheels_slip=True)
    return intervals


def solved_by_gtsam(intervals, settings):
    """(N, 4) poses and log-scales by Levenberg-Marquardt, and the error."""
    graph, values = whole_graph(intervals, settings)
    solution = solved(graph, values)
    poses = [solution.atPose2(factors.pose_key(interval.end)) for interval in intervals]
    scales = [solution.atDouble(factors.scale_key(interval.end)) for interval in intervals]
    return np.array([(p.x(), p.y(), p.theta(), scale) for p, scale in zip(poses, scales)]), graph.error(solution)


def as_table(nodes):
    return np.array([(*node.pose, node.log_scale) for node in nodes])


def test_the_solution_is_that_of_gtsam():
    """With the wheels' constants, where gtsam has our exact derivatives; robust losses are at work."""
    settings = FusionConfig(graph=GraphConfig(estimate_wheels=True))
    intervals = an_eventful_drive(150, 1)
    expected, _ = solved_by_gtsam(intervals, settings)
    found = as_table(smooth(measured(intervals, settings), settings))
    difference = found - expected
    difference[:, 2] = [planar.wrap(turn) for turn in difference[:, 2]]
    np.testing.assert_allclose(difference, 0.0, atol=1e-6)


def test_with_known_wheels_the_solution_is_at_least_as_good_as_that_of_gtsam():
    """gtsam's BetweenFactorPose2 has approximate derivatives, so it stops a little before."""
    intervals = an_eventful_drive(150, 2)
    expected, error = solved_by_gtsam(intervals, config())
    nodes = smooth(measured(intervals), config())
    np.testing.assert_allclose(as_table(nodes)[:, [0, 1, 3]], expected[:, [0, 1, 3]], atol=3e-4)
    graph, values = whole_graph(intervals, config())
    for interval, node in zip(intervals, nodes):
        values.update(factors.pose_key(interval.end), gtsam.Pose2(*node.pose))
        values.update(factors.scale_key(interval.end), node.log_scale)
    assert graph.error(values) <= error


def test_smoothing_ends_where_the_live_estimate_ends():
    intervals, _ = chain(80, np.random.default_rng(2))
    graph = WindowGraph(config(window=100), NOISE)
    for interval in intervals:
        graph.add(interval)
        live = graph.optimize()
    nodes = smooth(measured(intervals), config())
    assert len(nodes) == 80
    np.testing.assert_allclose(nodes[-1].pose, live.pose, atol=1e-4)
    assert nodes[-1].stamp_ns == live.stamp_ns


def test_one_wrong_visual_motion_does_little_harm():
    intervals, poses = chain(60)
    wrong = replace(intervals[30].visual, shift=intervals[30].visual.shift + np.array([0.05, -0.05]))
    intervals[30] = replace(intervals[30], visual=wrong)
    nodes = smooth(measured(intervals), config())
    assert np.abs(nodes[-1].pose[:2] - poses[-1][:2]).max() < 0.05 * SCALE / 5


def test_a_scale_that_is_far_from_its_first_guess_is_found():
    """A step from 4 m to 40 m makes the error larger: damping is at work."""
    intervals, poses = chain(60)
    intervals = [
        interval
        if interval.visual is None
        else replace(interval, visual=replace(interval.visual, shift=interval.visual.shift / 10.0))
        for interval in intervals
    ]
    nodes = smooth(measured(intervals), config())
    assert np.exp(nodes[-1].log_scale) == pytest.approx(10.0 * SCALE, rel=0.01)
    np.testing.assert_allclose(nodes[-1].pose[:2], poses[-1][:2], atol=1e-2)


def test_the_end_of_a_drive_goes_on_from_where_it_begins():
    """What was kept of a long drive: the last keyframes, and where the first of them was."""
    intervals, poses = chain(120)
    motions = measured(intervals)[60:]
    motions["start_pose"] = poses[60]
    nodes = smooth(motions, config())
    assert [node.stamp_ns for node in nodes] == [interval.stamp_ns for interval in intervals[60:]]
    np.testing.assert_allclose(nodes[-1].pose, poses[-1], atol=1e-3)
    assert np.exp(nodes[-1].log_scale) == pytest.approx(SCALE, rel=1e-3)


@pytest.mark.long
def test_the_keyframes_of_an_hour_are_solved_as_precisely_as_those_of_a_minute():
    """In absolute poses this would be a system that numbers of 64 bits cannot hold."""
    intervals, poses = chain(60)
    begin = measured(intervals[:1])
    hour = np.concatenate([begin, np.tile(measured(intervals[1:]), 305)])
    nodes = smooth(hour, config())
    assert len(nodes) == 17_996
    lap = planar.between(poses[1], poses[60])
    found = planar.between(nodes[-60].pose, nodes[-1].pose)
    np.testing.assert_allclose(found, lap, atol=1e-5)
    assert np.exp(nodes[-1].log_scale) == pytest.approx(SCALE, rel=1e-4)


def test_nothing_to_solve():
    assert smooth(measured([]), config()) == []


def test_a_motion_that_is_not_finite_is_an_error():
    intervals, _ = chain(10)
    motions = measured(intervals)
    motions["wheels"][3] = np.nan
    with pytest.raises(ValueError, match="NaNs"):
        smooth(motions, config())


def test_a_record_has_all_that_a_factor_takes_from_the_camera():
    """A new attribute must go into MOTION, too; these are the ones that are in it, or that no factor uses."""
    assert {field.name for field in fields(chain(2)[0][1].visual)} == {
        *("shift", "climb", "yaw", "tilt", "lever_m", "covariance")
    }


def test_the_same_measurements_give_the_same_bytes_wherever_they_lie_in_memory():
    """numpy's functions may differ in the last bit with the place of their arguments."""
    motions, rng = measured(an_eventful_drive(150, 3)), np.random.default_rng(0)
    kept, results = [], set()
    for _ in range(40):
        kept.append(np.empty(int(rng.integers(1, 5000)), np.uint8))  # so that memory is given elsewhere
        results.add(np.array([node.pose for node in smooth(motions, config())]).tobytes())
    assert len(results) == 1
