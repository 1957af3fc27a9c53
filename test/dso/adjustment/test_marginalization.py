# SPDX-License-Identifier: BSD-3-Clause
"""Marginalisation changes nothing for those that remain."""

import numpy as np
import pytest
from synthetic import RELIEF, hold_first_keyframe, linearized, true_window

from ceiling_dso_ros.dso.adjustment.bundle_adjustment import BundleAdjustment, affine_prior, marginalize_keyframe, solve
from ceiling_dso_ros.dso.config import OptimizationConfig
from ceiling_dso_ros.dso.geometry import se3


def quadratic_window(rng):
    """A window whose whole energy is a random prior, with the estimate away from the evaluation point."""
    window = true_window(3)
    J = rng.normal(size=(60, 28)) * np.r_[np.full(4, 10.0), np.tile([300.0] * 6 + [50.0, 5.0], 3)]
    window.prior.H[:], window.prior.b[:] = J.T @ J, J.T @ rng.normal(size=60)
    window.move(1e-3 * rng.normal(size=28))
    return window


@pytest.mark.parametrize("slot", [0, 1, 2])
@pytest.mark.parametrize("affine_information", [(0.0, 0.0), (1e4, 30.0)])
def test_marginalising_a_keyframe_keeps_the_solution_of_a_linear_problem(slot, affine_information):
    window, information = quadratic_window(np.random.default_rng(slot)), np.array(affine_information)

    def solution():
        diagonal, gradient = affine_prior(window, information)
        constant = gradient - diagonal * window.offsets  # the gradient of that prior where the offsets are zero
        return -np.linalg.solve(window.prior.H + np.diag(diagonal), window.prior.b + constant)

    before = solution()
    rest = np.delete(np.arange(28), np.arange(4 + 8 * slot, 12 + 8 * slot))
    marginalize_keyframe(window, slot, information)
    assert window.count == 2
    np.testing.assert_allclose(solution(), before[rest], atol=1e-7 * np.abs(before).max(), rtol=1e-6)
    np.testing.assert_array_equal(window.prior.H, window.prior.H.T)


@pytest.mark.parametrize("slot", [0, 1, 2])
def test_marginalising_keeps_the_information_of_those_that_remain(slot):
    """The covariance of those that remain is their block of the full covariance."""
    window = quadratic_window(np.random.default_rng(5))
    covariance = np.linalg.inv(window.prior.H)
    rest = np.delete(np.arange(28), np.arange(4 + 8 * slot, 12 + 8 * slot))
    marginalize_keyframe(window, slot, np.zeros(2))
    expected = covariance[np.ix_(rest, rest)]
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        np.linalg.inv(window.prior.H) / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-6
    )


def test_marginalising_a_keyframe_without_information_changes_nothing():
    window = true_window(3)
    J = np.random.default_rng(0).normal(size=(60, 20))
    window.prior.H[:20, :20], window.prior.b[:20] = J.T @ J, J.sum(axis=0)
    H, b = window.prior.H[:20, :20].copy(), window.prior.b[:20].copy()
    marginalize_keyframe(window, 2, np.zeros(2))
    np.testing.assert_allclose(window.prior.H, H, rtol=1e-12)
    np.testing.assert_allclose(window.prior.b, b, rtol=1e-12)


@pytest.mark.parametrize("weight", [1.0, 0.25])
def test_marginalised_points_leave_their_schur_complement_as_a_prior(weight):
    window = true_window(60, surface=RELIEF)
    rng = np.random.default_rng(0)
    window.move(np.r_[np.full(4, 0.2), np.tile(np.r_[np.full(6, 1e-3), 0.003, 0.5], 3)] * rng.normal(size=28))
    hold_first_keyframe(window)
    prior = window.prior.H.copy(), window.prior.b.copy()
    leaving = rng.uniform(size=180) < 0.4
    live = window.points.residuals.live.copy()

    alone = true_window(60, surface=RELIEF)
    alone.move(window.offsets)
    alone.points.keep(leaving)
    expected = linearized(alone)

    adjustment = BundleAdjustment(window, OptimizationConfig(marginalization_weight=weight))
    adjustment.marginalize_points(window, leaving)
    np.testing.assert_array_equal(window.points.residuals.live, live)
    scale = np.sqrt(np.diag(expected.H))
    added = (window.prior.H - prior[0]) / weight
    tolerance = 1e-5 + 1e-15 * np.array([1e11 if 4 <= i < 12 else 0 for i in range(28)]).max() / scale.min() ** 2
    np.testing.assert_allclose(added / np.outer(scale, scale), expected.H / np.outer(scale, scale), atol=tolerance)
    # at the estimate the prior's gradient grew by that of the points
    gradient = window.prior.b + window.prior.H @ window.offsets - prior[1] - prior[0] @ window.offsets
    np.testing.assert_allclose(gradient / weight / scale, expected.b / scale, atol=2e-3)


def test_marginalising_points_and_their_keyframe_keeps_the_step_of_the_rest():
    """The whole way of a keyframe out of the window, on one linearisation.

    Only points of keyframe 0 tie it to the others, so that nothing is dropped on its way out; then the next step of the
    others must be the one that the full window would have taken.
    """
    window = true_window(120, surface=RELIEF)
    window.points.residuals.live[0] = 0
    rng = np.random.default_rng(0)
    window.move(np.r_[np.full(4, 0.2), np.tile(np.r_[np.full(6, 1e-3), 0.003, 0.5], 3)] * rng.normal(size=28))
    window.prior.H[np.diag_indices(28)] = np.r_[np.full(4, 1e4), np.tile([1e5] * 6 + [1e4, 10.0], 3)]
    adjustment = BundleAdjustment(window, OptimizationConfig(marginalization_weight=1.0))

    def step():
        result = linearized(window)
        return -np.linalg.solve(result.H + window.prior.H, result.b + window.prior.b + window.prior.H @ window.offsets)

    before = step()
    assert np.abs(before[12:]).max() > 1e-4
    hosted = window.points.arrays.host[: window.points.count] == 0
    adjustment.marginalize_points(window, hosted)
    window.points.keep(~hosted)
    between = step()
    scale = np.abs(before)
    np.testing.assert_allclose(between, before, atol=1e-3 * scale.max(), rtol=1e-3)
    marginalize_keyframe(window, 0, np.zeros(2))
    rest = np.r_[np.arange(4), np.arange(12, 28)]
    np.testing.assert_allclose(step(), before[rest], atol=1e-3 * scale.max(), rtol=1e-3)


def test_the_prior_of_marginalised_points_holds_the_window():
    """With all points of the oldest keyframe turned into a prior, a perturbed rest comes back as far as it is tied."""
    window = true_window(200, surface=RELIEF)
    hold_first_keyframe(window)
    adjustment = BundleAdjustment(window, OptimizationConfig())
    adjustment.optimize(window)
    for slot in range(3):
        window.relinearize(slot)
    hosted = window.points.arrays.host[: window.points.count] == 0
    adjustment.marginalize_points(window, hosted)
    window.points.keep(~hosted)
    marginalize_keyframe(window, 0, np.zeros(2))
    expected = window.keyframes.T_camera_world[:2].copy()

    def errors_up_to_scale():
        ours = window.keyframes.T_camera_world[:2].copy()
        scale = (ours[:, :3, 3] * expected[:, :3, 3]).sum() / (expected[:, :3, 3] ** 2).sum()
        ours[:, :3, 3] /= scale
        return np.abs([se3.log(a @ np.linalg.inv(b)) for a, b in zip(ours, expected)]).max()

    window.move(
        np.r_[np.zeros(4), np.tile(np.r_[np.full(6, 1e-3), 0, 0], 2)] * np.random.default_rng(0).normal(size=20)
    )
    before = errors_up_to_scale()
    for _ in range(6):
        result = linearized(window)
        H = result.H + window.prior.H
        step = solve(H, result.b + window.prior.b + window.prior.H @ window.offsets)
        idepth = result.idepth_steps(window, step)
        window.move(step)
        window.points.arrays.idepth[: window.points.count] += idepth
    assert errors_up_to_scale() < 0.25 * before
