# SPDX-License-Identifier: BSD-3-Clause
"""Joint alignment of pose, brightness and inverse depths of one level."""

import numpy as np
import pytest
from synthetic import CAMERA, Surface, random_pixels

from ceiling_dso_ros.dso.adjustment.linearization import scratch_memory
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.images.selection import SelectedPixels
from ceiling_dso_ros.dso.start.initialization_kernels import (
    align_level,
    eliminate_idepths,
    linearize_level,
    regularization_energy,
    smooth,
    step_idepths,
)
from ceiling_dso_ros.dso.window.candidates import CandidateTable
from ceiling_dso_ros.dso.window.points import point_arrays, residual_arrays

SURFACE = Surface(slope=(0.1, -0.15), relief=0.05)
T_TRUE = se3.exp(np.array([0.06, 0.03, -0.02, 0.01, -0.01, 0.04]))
LIGHT_TRUE = np.array([0.1, -5.0])
THRESHOLD = 12.0 * 12.0 * 8 * 4


def level_points(error=0.0):
    """Points with texture of a first frame at the origin, inverse depths off by a share `error`."""
    rng = np.random.default_rng(0)
    u, v = random_pixels(rng, 1000)
    table = CandidateTable(1000)
    table.add(SelectedPixels(u, v, np.ones_like(u)), 0, SURFACE.render(np.eye(4)).ravel(), 320)
    table.keep(table.arrays.grad_xx + table.arrays.grad_yy > 100)
    a, n = table.arrays, table.count
    points, residuals = point_arrays(n), residual_arrays(1, n)
    true = SURFACE.idepth(np.eye(4), a.u[:n], a.v[:n]).astype(np.float32)
    points.u[:], points.v[:], points.grey[:], points.weight[:] = a.u[:n], a.v[:n], a.grey[:, :n], a.weight[:, :n]
    points.idepth[:] = true * (1 + error * rng.normal(size=n))
    residuals.live[:] = 1
    return points, residuals, true


IMAGE = (np.exp(LIGHT_TRUE[0]) * SURFACE.render(T_TRUE) + LIGHT_TRUE[1]).astype(np.float32).ravel()


def linearized(points, residuals, T, light):
    system = np.empty((13, 13))
    energy, in_view = linearize_level(
        points, residuals, points.u.size, IMAGE, 320, 240, CAMERA.parameters, T, light, THRESHOLD,
        scratch_memory(1, points.u.size), system,
    )  # fmt: skip
    return energy, in_view, system


def test_gradient_is_that_of_the_energy():
    points, residuals, _ = level_points(error=0.01)
    T = se3.exp(np.array([1e-3, -2e-3, 1e-3, 1e-3, 2e-3, -2e-3])) @ T_TRUE
    light = LIGHT_TRUE + np.array([0.01, 1.0])
    _, _, system = linearized(points, residuals, T, light)
    # the pair's columns are I_host and 1; the residual falls with both
    gradient = system[4:12, 12] * np.r_[np.ones(6), -np.exp(light[0]), -1.0]
    numeric = []
    for e, h in zip(np.eye(8), [2e-4] * 6 + [1e-3, 0.05]):
        plus, minus = (
            linearized(points, residuals, se3.exp(s * h * e[:6]) @ T, light + s * h * e[6:])[0] for s in (1, -1)
        )
        numeric.append((plus - minus) / (2 * h) / 2)
    for part in (slice(0, 3), slice(3, 6), slice(6, 7), slice(7, 8)):
        np.testing.assert_allclose(gradient[part], numeric[part], rtol=0.05, atol=0.05 * np.abs(numeric[part]).max())


def test_elimination_and_back_substitution_are_the_full_solution():
    rng = np.random.default_rng(0)
    n, weight, damping = 20, 3.0, 0.1
    points, target = point_arrays(n), rng.uniform(0.9, 1.1, n).astype(np.float32)
    points.idepth[:], points.idepth_hessian[:] = rng.uniform(0.8, 1.2, n), rng.uniform(5, 50, n)
    points.idepth_gradient[:] = rng.normal(size=n)
    rows = rng.normal(size=(8, n)).astype(np.float32)
    J = rng.normal(size=(100, 8))
    H, b = J.T @ J, rng.normal(size=8)

    H_depth = (points.idepth_hessian + weight) * (1 + damping)
    b_depth = points.idepth_gradient + weight * (points.idepth - target)
    full = np.block([[H, rows], [rows.T, np.diag(H_depth)]])
    solution = -np.linalg.solve(full, np.concatenate([b, b_depth]))

    reduced, reduced_b = H.copy(), b.copy()
    eliminate_idepths(points, rows, n, target, weight, damping, reduced, reduced_b)
    lower = np.tril(reduced)
    step = -np.linalg.solve(lower + np.tril(lower, -1).T, reduced_b)
    np.testing.assert_allclose(step, solution[:8], rtol=1e-4)
    before = points.idepth.copy()
    step_idepths(points, rows, n, target, weight, damping, step)
    np.testing.assert_allclose(points.idepth - before, solution[8:], atol=1e-5)


def test_inverse_depths_stay_positive():
    points = point_arrays(2)
    points.idepth[:], points.idepth_hessian[:], points.idepth_gradient[:] = 1.0, 1.0, (1e6, -1e6)
    step_idepths(points, np.zeros((8, 2), np.float32), 2, np.ones(2, np.float32), 0.0, 0.0, np.zeros(8))
    assert 0 < points.idepth[0] < 0.1
    assert 10 < points.idepth[1] < 1000


def align(points, residuals, T, light, target, weight, pull=0.0, iterations=30):
    return align_level(
        points, residuals, points.u.size, IMAGE, 320, 240, CAMERA.parameters, T, light, pull, target, weight,
        THRESHOLD, iterations, scratch_memory(1, points.u.size),
    )  # fmt: skip


def test_true_depths_give_the_true_motion_and_brightness():
    points, residuals, true = level_points()
    start = se3.exp(np.array([4e-3, -4e-3, 3e-3, 3e-3, 2e-3, -3e-3])) @ T_TRUE
    T, light, rmse, in_view = align(points, residuals, start, LIGHT_TRUE + np.array([0.02, 2.0]), true, 1e8)
    assert np.abs(se3.log(T @ np.linalg.inv(T_TRUE))).max() < 2e-4
    assert np.exp(light[0]) * 120 + light[1] == pytest.approx(np.exp(LIGHT_TRUE[0]) * 120 + LIGHT_TRUE[1], abs=0.3)
    assert rmse < 0.3
    assert in_view > 0.9


def test_wrong_depths_are_corrected():
    points, residuals, true = level_points(error=0.03)
    T, _, rmse, _ = align(points, residuals, T_TRUE, LIGHT_TRUE, true, 1e-3)
    scale = np.median(points.idepth / true)
    informative = points.idepth_hessian > 100
    assert informative.sum() > 300
    assert np.median(np.abs(points.idepth / true / scale - 1)[informative]) < 0.005  # the start is off by 0.02
    ours, expected = T[:3, 3] * scale, T_TRUE[:3, 3]
    assert np.linalg.norm(ours - expected) < 0.02 * np.linalg.norm(expected)
    assert rmse < 0.3


def test_a_pull_keeps_the_translation_at_zero():
    points, residuals, true = level_points()
    T, _, _, _ = align(points, residuals, np.eye(4), LIGHT_TRUE, true, 1.0, pull=1e12)
    assert np.linalg.norm(T[:3, 3]) < 1e-6


def test_nothing_in_view_is_an_infinite_error():
    points, residuals, true = level_points()
    away = se3.exp(np.array([0, 0, 0, 0, 2.0, 0]))
    T, _, rmse, in_view = align(points, residuals, away, LIGHT_TRUE, true, 1.0)
    assert rmse == np.inf
    assert in_view == 0
    assert np.isfinite(T).all()
    assert np.isfinite(points.idepth).all()


def test_regularization_energy():
    points = point_arrays(4)
    points.idepth[:] = [1, 2, 3, 4]
    assert regularization_energy(points, 3, np.zeros(4, np.float32), 2.0) == pytest.approx(2 * (1 + 4 + 9))


def test_smoothing_mixes_with_the_median_of_informative_neighbours():
    idepth = np.array([1, 2, 3, 10, 50], np.float32)
    hessian = np.array([1, 1, 1, 1, 0], np.float32)
    neighbours = np.array([[1, 2, 3, 4], [0, 2, 3, 4], [4, 4, 0, 1], [0, 1, 2, 4], [0, 1, 2, 3]])
    result = np.empty(5, np.float32)
    smooth(idepth, hessian, neighbours, 0.2, result)
    expected = [0.2 + 0.8 * 3, 0.4 + 0.8 * 3, 3.0, 2.0 + 0.8 * 2, 10 + 0.8 * 2.5]  # the third has only two
    np.testing.assert_allclose(result, expected, rtol=1e-6)
