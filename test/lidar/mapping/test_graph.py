# SPDX-License-Identifier: BSD-3-Clause
import numpy as np

from ceiling_dso_ros.lidar.mapping.graph import Relation, solve_graph
from ceiling_dso_ros.lidar.scans.poses import between, compose

SIGMA = np.diag([0.02, 0.02, 0.01]) ** 2


def ring(count=24):
    angles = np.linspace(0.0, 2 * np.pi, count, endpoint=False)
    poses = np.column_stack([3.0 * np.sin(angles), 3.0 - 3.0 * np.cos(angles), angles])
    return compose(np.zeros((count, 3)), poses)


def test_a_right_loop_removes_the_drift_and_a_wrong_one_is_found():
    rng = np.random.default_rng(0)
    truth = ring()
    moved = compose(between(truth[:-1], truth[1:]), rng.standard_normal((23, 3)) * (0.02, 0.02, 0.01))
    chain = [Relation(k, k + 1, step, SIGMA) for k, step in enumerate(moved)]
    start = [truth[0]]
    for step in moved:
        start.append(compose(start[-1], step))
    start = np.array(start)
    right = Relation(0, 23, between(truth[:1], truth[23:])[0], SIGMA)
    wrong = Relation(2, 14, np.array([0.1, 0.2, 0.3]), SIGMA)
    solution = solve_graph(start, chain, [right, wrong])
    assert solution.is_right.tolist() == [True, False]
    drift = np.hypot(*(start[23] - truth[23])[:2])
    assert np.hypot(*(solution.poses[23] - truth[23])[:2]) < 0.5 * drift
    np.testing.assert_allclose(solution.poses[0], truth[0], atol=1e-4)


def test_without_loops_the_chain_stays():
    truth = ring(5)
    chain = [Relation(k, k + 1, step, SIGMA) for k, step in enumerate(between(truth[:-1], truth[1:]))]
    np.testing.assert_allclose(solve_graph(truth, chain, []).poses, truth, atol=1e-6)
    np.testing.assert_allclose(solve_graph(truth[:1], [], []).poses, truth[:1], atol=1e-9)
