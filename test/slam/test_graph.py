# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.slam.deciding import walked
from ceiling_dso_ros.slam.graph import PoseGraph
from ceiling_dso_ros.slam.site_map import Edge

COUNT = 80
STEP = np.array([0.5, 0.0, 2 * np.pi / 40])
LOOP_COVARIANCE = np.diag([1e-4, 1e-4, 1e-6])


@pytest.fixture
def laps():
    """Two laps of 40 keyframes: graph, true poses, and a function that makes a loop."""
    rng = np.random.default_rng(3)
    graph, true = PoseGraph(), [np.zeros(3)]
    graph.place(0, np.zeros(3))
    covariance = walked(STEP)
    for i in range(1, COUNT):
        true.append(planar.compose(true[-1], STEP))
        motion = planar.compose(STEP, rng.multivariate_normal(np.zeros(3), covariance))
        graph.place(i, planar.compose(graph.poses[i - 1], motion))
        graph.connect(Edge(i - 1, i, motion, covariance, False))

    def loop(start, end, wrong_by=(0.0, 0.0, 0.0)):
        error = planar.compose(np.asarray(wrong_by), rng.multivariate_normal(np.zeros(3), LOOP_COVARIANCE))
        motion = planar.compose(planar.between(true[start], true[end]), error)
        return Edge(start, end, motion, LOOP_COVARIANCE, True)

    return graph, true, loop


def largest_error_m(graph, true):
    return max(np.hypot(*(graph.poses[i] - true[i])[:2]) for i in graph.poses)


def test_right_loops_take_the_drift_away(laps):
    graph, true, loop = laps
    before_m = largest_error_m(graph, true)
    assert graph.close([loop(i - 40, i) for i in range(45, 80, 6)]) == ""
    assert largest_error_m(graph, true) < max(0.5 * before_m, 0.03)


def test_wrong_loops_of_a_whole_bay_are_taken_back(laps):
    graph, _, loop = laps
    poses = dict(graph.poses)
    assert graph.close([loop(5, i, (1.2, 0.0, 0.0)) for i in (45, 46, 47)]) != ""
    assert graph.poses == poses
    assert not any(edge.is_loop for edge in graph.edges)


def test_covariances_are_those_of_the_error(laps):
    graph, _, loop = laps
    far = graph.covariances_from(79, [39])[39]
    graph.close([loop(i - 40, i) for i in range(45, 80, 6)])
    near = graph.covariances_from(79, [39])[39]
    assert np.sqrt(far[0, 0]) > 0.01
    assert np.sqrt(near[0, 0]) < np.sqrt(far[0, 0])


def test_a_keyframe_that_is_let_go_leaves_the_others_where_they_are(laps):
    graph, _, loop = laps
    graph.close([loop(i - 40, i) for i in range(45, 80, 6)])
    before = {number: pose for number, pose in graph.poses.items() if number != 51}
    graph.let_go(51)
    assert graph.close([]) == ""
    for number, pose in before.items():
        assert np.hypot(*(graph.poses[number] - pose)[:2]) < 0.01
    assert sum(edge.end == 52 for edge in graph.edges) == 2  # the odometry, and the loop that went through


@pytest.mark.parametrize("axis", range(3))
def test_a_motion_that_nobody_knows_leaves_the_graph_solvable(laps, axis):
    graph, _, _ = laps
    covariance = np.diag([1e-13, 1e-13, 1e-13])  # what a keyframe's message may hold: as exact ...
    covariance[axis, axis] = 1e8  # ... and as vague
    for number in range(COUNT, COUNT + 3):
        graph.place(number, planar.compose(graph.poses[number - 1], STEP))
        graph.connect(Edge(number - 1, number, STEP, covariance, False))
    assert np.sqrt(graph.covariance(COUNT + 2)[axis, axis]) > 1.0
    assert graph.close([Edge(COUNT + 1, COUNT + 2, STEP, LOOP_COVARIANCE, True)]) == ""
