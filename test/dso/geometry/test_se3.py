# SPDX-License-Identifier: BSD-3-Clause
"""Rigid motions against the matrix exponential and numeric differences."""

import numpy as np
import pytest
from scipy.linalg import expm

from ceiling_dso_ros.dso.geometry import se3

RNG = np.random.default_rng(0)
TANGENTS = [np.concatenate([RNG.normal(size=3), RNG.normal(size=3)]) for _ in range(10)]
SMALL = [1e-3 * xi for xi in TANGENTS[:3]] + [1e-6 * xi for xi in TANGENTS[:3]] + [np.zeros(6)]
SLOW_TURNS = [np.concatenate([xi[:3], 1e-6 * xi[3:]]) for xi in TANGENTS[:3]]


def generator(xi):
    matrix = np.zeros((4, 4))
    matrix[:3, :3] = [[0, -xi[5], xi[4]], [xi[5], 0, -xi[3]], [-xi[4], xi[3], 0]]
    matrix[:3, 3] = xi[:3]
    return matrix


def test_hat_is_the_cross_product():
    a, b = RNG.normal(size=(2, 3))
    assert se3.hat(a) @ b == pytest.approx(np.cross(a, b), abs=1e-15)


@pytest.mark.parametrize("xi", TANGENTS + SMALL + SLOW_TURNS)
def test_exp_is_the_matrix_exponential(xi):
    np.testing.assert_allclose(se3.exp(xi), expm(generator(xi)), atol=1e-10)


@pytest.mark.parametrize("xi", TANGENTS + SMALL + SLOW_TURNS)
def test_log_undoes_exp(xi):
    xi = xi.copy()
    xi[3:] *= min(1.0, 3.0 / max(np.linalg.norm(xi[3:]), 1e-30))  # within half a turn
    np.testing.assert_allclose(se3.log(se3.exp(xi)), xi, atol=1e-10)


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (-0.6, 0.8, 0), (0.48, -0.6, 0.64)])
@pytest.mark.parametrize("short", [0.0, 1e-9, 1e-7, 1e-4])
def test_log_near_half_a_turn(axis, short):
    T = se3.exp(np.concatenate([[0.3, -0.2, 0.5], (np.pi - short) * np.array(axis)]))
    np.testing.assert_allclose(se3.exp(se3.log(T)), T, atol=1e-7)


@pytest.mark.parametrize("xi", TANGENTS)
def test_inverse(xi):
    T = se3.exp(xi)
    np.testing.assert_allclose(se3.inverse(T), np.linalg.inv(T), atol=1e-14)


@pytest.mark.parametrize("xi", TANGENTS)
def test_adjoint_moves_an_increment_to_the_other_side(xi):
    T, increment = se3.exp(xi), RNG.normal(size=6)
    np.testing.assert_allclose(
        se3.exp(se3.adjoint(T) @ increment), T @ se3.exp(increment) @ np.linalg.inv(T), atol=1e-12
    )


def test_a_left_increment_moves_a_point_by_translation_and_cross_product():
    T, point, h = se3.exp(TANGENTS[0]), np.array([0.3, -0.4, 2.0, 1.0]), 1e-6
    moved = T @ point
    numeric = np.stack([(se3.exp(h * e) @ moved - se3.exp(-h * e) @ moved)[:3] / (2 * h) for e in np.eye(6)], axis=1)
    np.testing.assert_allclose(numeric, np.hstack([np.eye(3), -se3.hat(moved[:3])]), atol=1e-8)


def test_orthonormalized_is_the_nearest_motion():
    T = se3.exp(TANGENTS[1])
    rounded = T.copy()
    rounded[:3, :3] *= 1 + 1e-6
    result = se3.orthonormalized(rounded)
    np.testing.assert_allclose(result, T, atol=1e-14)
    np.testing.assert_allclose(result[:3, :3] @ result[:3, :3].T, np.eye(3), atol=1e-15)
