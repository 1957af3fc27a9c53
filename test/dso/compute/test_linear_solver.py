# SPDX-License-Identifier: BSD-3-Clause
"""The solver of the kernels against numpy."""

import numpy as np
import pytest

from ceiling_dso_ros.dso.compute.linear_solver import invert_positive, solve_positive


def positive_matrix(rng, n):
    J = rng.normal(size=(3 * n, n))
    return J.T @ J


@pytest.mark.parametrize("n", [1, 3, 8, 20])
def test_solution_is_numpys(n):
    rng = np.random.default_rng(n)
    H, b = positive_matrix(rng, n), rng.normal(size=n)
    np.testing.assert_allclose(solve_positive(H, b), np.linalg.solve(H, b), rtol=1e-9)


def test_badly_scaled_parameters():
    rng = np.random.default_rng(0)
    scale = 10.0 ** np.array([-6, -3, 0, 3, 6, 9])
    H, x = positive_matrix(rng, 6) * scale[:, None] * scale, rng.normal(size=6) / scale
    np.testing.assert_allclose(solve_positive(H, H @ x), x, rtol=1e-7)


def test_only_the_lower_triangle_is_read():
    rng = np.random.default_rng(0)
    H, b = positive_matrix(rng, 5), rng.normal(size=5)
    np.testing.assert_array_equal(solve_positive(np.tril(H), b), solve_positive(H, b))


def test_no_information_gives_no_step():
    rng = np.random.default_rng(0)
    H, b = np.zeros((6, 6)), rng.normal(size=6)
    assert not solve_positive(H, b).any()
    H[:4, :4] = positive_matrix(rng, 4)
    x = solve_positive(H, b)
    np.testing.assert_allclose(x[:4], np.linalg.solve(H[:4, :4], b[:4]), rtol=1e-9)
    assert not x[4:].any()


def test_a_repeated_parameter_gets_a_finite_solution():
    rng = np.random.default_rng(0)
    J = rng.normal(size=(20, 4))
    J[:, 3] = J[:, 2]
    H, b = J.T @ J, J.T @ rng.normal(size=20)
    x = solve_positive(H, b)
    np.testing.assert_allclose(H @ x, b, atol=1e-8)
    assert x[3] == 0


def test_inverse_is_numpys_and_zero_where_nothing_is_known():
    rng = np.random.default_rng(0)
    H = np.zeros((8, 8))
    H[:6, :6] = positive_matrix(rng, 6)
    expected = np.zeros((8, 8))
    expected[:6, :6] = np.linalg.inv(H[:6, :6])
    np.testing.assert_allclose(invert_positive(H), expected, rtol=1e-8, atol=1e-12)
