# SPDX-License-Identifier: BSD-3-Clause
from dataclasses import replace

import numpy as np
import pytest
from gtsam_solution import solved, whole_graph
from winding_chain import NOISE, SCALE, chain, config

from ceiling_dso_ros.dso.status import KeyframeEstimate, ScaleMeasurement
from ceiling_dso_ros.fusion import factors
from ceiling_dso_ros.fusion.config import FusionConfig, GraphConfig
from ceiling_dso_ros.fusion.graph import FactorBuilder, WindowGraph
from ceiling_dso_ros.fusion.linear import joint_covariance
from ceiling_dso_ros.fusion.metre import METRE_KEY, metre_sigma, usable_scale
from ceiling_dso_ros.fusion.motion import MOTION
from ceiling_dso_ros.fusion.smoothing import smooth

COMMON, OWN = 0.004, 0.002
RADIUS = NOISE.config.radius_sigma


def seen_twice(count, rng=None, error=0.0, **arguments):
    """A chain whose scale a second camera measures, with an error that all have in common."""
    intervals, poses = chain(count, rng, **arguments)
    scales = [SCALE * (1.4 if arguments.get("segment_at", count + 1) <= i.end else 1.0) for i in intervals]
    noise = np.zeros(count) if rng is None else OWN * rng.normal(size=count)
    measured = np.log(scales) + error + noise
    return [replace(i, stereo=ScaleMeasurement(z, OWN, COMMON)) for i, z in zip(intervals, measured)], poses


@pytest.mark.parametrize("estimate_wheels", [False, True])
def test_the_solution_of_a_whole_drive_is_that_of_gtsam(estimate_wheels):
    """With two segments, keyframes without a measurement, and wrong ones, on which the robust loss is at work."""
    settings = FusionConfig(graph=GraphConfig(estimate_wheels=estimate_wheels))
    intervals, _ = seen_twice(80, np.random.default_rng(3), error=0.006, segment_at=40)
    for index in (7, 41):
        stereo = intervals[index].stereo
        intervals[index] = replace(intervals[index], stereo=stereo._replace(log_scale=stereo.log_scale + 0.3))
    intervals[20:25] = [replace(interval, stereo=None) for interval in intervals[20:25]]
    solution = solved(*whole_graph(intervals, settings))
    builder = FactorBuilder(settings, NOISE)
    nodes = smooth(np.array([builder.motion(i, np.zeros(3)) for i in intervals], MOTION), settings)
    expected = [solution.atDouble(factors.scale_key(interval.end)) for interval in intervals]
    # gtsam's own factor of the wheels has approximate derivatives, so that it stops a little before
    tolerance = 1e-6 if estimate_wheels else 1e-4
    np.testing.assert_allclose([node.log_scale for node in nodes], expected, atol=tolerance)
    positions = [(solution.atPose2(factors.pose_key(i.end)).x(), nodes[k].pose[0]) for k, i in enumerate(intervals)]
    np.testing.assert_allclose(*np.array(positions).T, atol=10 * tolerance)


def test_the_difference_of_the_two_metres_is_found_and_does_not_move_the_poses():
    intervals, poses = seen_twice(60, error=0.006)
    graph = WindowGraph(config(), NOISE)
    for interval in intervals:
        graph.add(interval)
        estimate = graph.optimize()
    assert estimate.log_metre == pytest.approx(-0.006, abs=5e-4)
    assert np.exp(estimate.log_scale) == pytest.approx(SCALE, rel=5e-4)
    np.testing.assert_allclose(estimate.pose[:2], poses[-1][:2], atol=3e-3)


def test_measurements_of_one_pair_of_cameras_do_not_average_its_error_out():
    """While nothing moves, only the second camera tells the scale."""
    intervals, _ = seen_twice(15)
    graph = WindowGraph(config(), NOISE)
    sigmas = []
    for interval in intervals:
        graph.add(replace(interval, visual=None))
        sigmas.append(graph.optimize().scale_sigma)
    before = np.hypot(COMMON, RADIUS)
    assert sigmas[0] == pytest.approx(np.hypot(before, OWN), rel=1e-3)
    assert before < sigmas[-1] < sigmas[0]


def test_a_new_segment_has_its_scale_at_once_where_the_metre_is_known():
    intervals, _ = seen_twice(60, np.random.default_rng(0), error=0.006, segment_at=50)
    graph = WindowGraph(config(), NOISE)
    sigmas = {}
    for interval in intervals:
        graph.add(interval)
        estimate = graph.optimize()
        sigmas[interval.end] = estimate.scale_sigma
        if interval.end == 50:
            assert estimate.log_scale == pytest.approx(np.log(1.4 * SCALE), abs=4 * OWN)
    assert sigmas[50] < 1.5 * OWN


def test_errors_agree_with_the_covariance():
    """Of the scale while wheels and cameras share the work, and of the difference of the metres; 200 drives."""
    squares = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        metre = np.hypot(COMMON, RADIUS) * rng.normal()
        intervals, _ = seen_twice(12, rng, error=-metre)
        graph, values = whole_graph(intervals, config())
        solution = solved(graph, values)
        keys = [factors.scale_key(12), METRE_KEY]
        error = [solution.atDouble(keys[0]) - np.log(SCALE), solution.atDouble(keys[1]) - metre]
        covariance = joint_covariance(graph.linearize(solution), keys, 2)
        squares.append(np.array(error) @ np.linalg.solve(covariance, error))
    assert np.mean(squares) == pytest.approx(2.0, abs=4 * np.sqrt(2 * 2 / 200))


def test_without_a_second_camera_the_graph_has_no_such_variable():
    intervals, _ = chain(5)
    _, values = whole_graph(intervals, config())
    assert not values.exists(METRE_KEY)
    graph = WindowGraph(config(), NOISE)
    graph.add(intervals[0])
    assert np.isnan(graph.optimize().log_metre)


def test_what_a_keyframe_says_of_the_scale():
    keyframe = KeyframeEstimate(1, 1, 0, np.eye(4), (0.0, 0.0), False)
    assert usable_scale(keyframe) is None
    told = replace(keyframe, scale=ScaleMeasurement(1.4, 0.01, 0.003))
    assert usable_scale(told) == (1.4, 0.01, 0.003)
    assert usable_scale(replace(told, scale=told.scale._replace(sigma=0.0))) is None
    assert metre_sigma(usable_scale(told), 0.004) == pytest.approx(0.005)
