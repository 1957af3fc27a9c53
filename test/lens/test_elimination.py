# SPDX-License-Identifier: BSD-3-Clause
"""The normal equations without the points against dense ones with them."""

import numpy as np
import pytest

from ceiling_dso_ros.lens.elimination_kernels import Equations, add_sightings, point_steps, sighting_scores

FIRST = np.array([0, 3, 4, 6])
HOST = np.array([0, 0, 1])
TARGET = np.array([1, 2, 3, 2, 2, 3])
OFFSET, KEYFRAMES, POINTS = 15, 4, 3
SIZE = OFFSET + 6 * KEYFRAMES


@pytest.fixture(scope="module")
def problem():
    rng = np.random.default_rng(0)
    changes = [rng.normal(size=(len(TARGET), 2, count)) for count in (12, 6, 6, 3)]
    residual = rng.normal(size=(len(TARGET), 2))
    own = np.array([np.diag([2.0, 3.0, 0.5]) + 0.1 for _ in range(POINTS)])
    return Equations(FIRST, HOST, TARGET, OFFSET, *changes, residual, own, rng.normal(size=(POINTS, 3)))


def dense(problem):
    """Information and gradient of all unknowns, the points last."""
    *_, of_camera, of_host, of_target, of_point, residual, own, pull = problem
    H, b = np.zeros((SIZE + 3 * POINTS,) * 2), np.zeros(SIZE + 3 * POINTS)
    point = np.repeat(np.arange(POINTS), np.diff(FIRST))
    for m, p in enumerate(point):
        J = np.zeros((2, len(b)))
        J[:, :12] = of_camera[m]
        J[:, OFFSET + 6 * HOST[p] : OFFSET + 6 * HOST[p] + 6] = of_host[m]
        J[:, OFFSET + 6 * TARGET[m] : OFFSET + 6 * TARGET[m] + 6] = of_target[m]
        J[:, SIZE + 3 * p : SIZE + 3 * p + 3] = of_point[m]
        H += J.T @ J
        b += J.T @ residual[m]
    for p in range(POINTS):
        mine = slice(SIZE + 3 * p, SIZE + 3 * p + 3)
        H[mine, mine] += own[p]
        b[mine] += pull[p]
    return H, b


def test_what_is_left_without_the_points(problem):
    H, b = dense(problem)
    back = np.linalg.inv(H[SIZE:, SIZE:])
    found, scores = np.zeros((SIZE, SIZE)), np.zeros((2, SIZE))
    add_sightings(problem, cluster=np.array([0, 1, 0]), H=found, scores=scores)
    np.testing.assert_allclose(found, H[:SIZE, :SIZE] - H[:SIZE, SIZE:] @ back @ H[SIZE:, :SIZE], atol=1e-10)
    np.testing.assert_allclose(scores.sum(axis=0), b[:SIZE] - H[:SIZE, SIZE:] @ back @ b[SIZE:], atol=1e-10)
    assert np.abs(scores).max(axis=1).min() > 0.1


def test_steps_of_the_points(problem):
    step = np.random.default_rng(1).normal(size=SIZE)
    H, b = dense(problem)
    expected = -np.linalg.solve(H[SIZE:, SIZE:], b[SIZE:] + H[SIZE:, :SIZE] @ step)
    np.testing.assert_allclose(point_steps(problem, step=step).ravel(), expected, atol=1e-10)


def test_gradients_of_sightings_are_parts_of_the_whole(problem):
    whole, parts = np.zeros((1, SIZE)), np.zeros((3, SIZE))
    add_sightings(problem, cluster=np.zeros(POINTS, np.int64), H=np.zeros((SIZE, SIZE)), scores=whole)
    sighting_scores(problem, group=np.array([0, 1, 2, 0, 1, 2]), host_group=np.array([2, 0, 1]), scores=parts)
    np.testing.assert_allclose(parts.sum(axis=0), whole[0], atol=1e-10)
