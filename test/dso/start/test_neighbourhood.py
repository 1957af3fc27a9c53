# SPDX-License-Identifier: BSD-3-Clause
"""Nearest neighbours against brute force."""

import numpy as np
import pytest

from ceiling_dso_ros.dso.start.neighbourhood import nearest_neighbours


def brute_force(u, v, query_u, query_v, wanted):
    distance = np.hypot(u[None] - query_u[:, None], v[None] - query_v[:, None])
    return np.sort(distance, axis=1)[:, :wanted]


@pytest.mark.parametrize(("points", "wanted"), [(500, 10), (500, 1), (37, 10), (11, 10), (3, 3)])
@pytest.mark.parametrize("clustered", [False, True])
def test_distances_are_those_of_brute_force(points, wanted, clustered):
    rng = np.random.default_rng(points)
    share = 0.2 if clustered else 1.0
    u, v = ((rng.uniform(0, side * share, points)).astype(np.float32) for side in (160, 120))
    query_u, query_v = (rng.uniform(0, side - 1, 100).astype(np.float32) for side in (160, 120))
    found = nearest_neighbours(u, v, query_u, query_v, 160, 120, wanted)
    assert found.shape == (100, wanted)
    distance = np.hypot(u[found] - query_u[:, None], v[found] - query_v[:, None])
    np.testing.assert_allclose(distance, brute_force(u, v, query_u, query_v, wanted), rtol=1e-5)
    assert all(len(set(row)) == wanted for row in found)


def test_a_point_is_its_own_nearest():
    rng = np.random.default_rng(0)
    u, v = rng.permutation(160)[:100].astype(np.float32), rng.uniform(0, 119, 100).astype(np.float32)
    assert nearest_neighbours(u, v, u, v, 160, 120, 10)[:, 0].tolist() == list(range(100))


def test_too_few_points_repeat_the_nearest():
    u, v = np.array([10.0, 150.0], np.float32), np.array([10.0, 100.0], np.float32)
    found = nearest_neighbours(u, v, np.array([140.0], np.float32), np.array([90.0], np.float32), 160, 120, 4)
    assert found.tolist() == [[1, 0, 1, 1]]
