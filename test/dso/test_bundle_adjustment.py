"""Bundle adjustment finds the truth again; marginalisation changes nothing for those that remain."""

import numpy as np
import pytest
from synthetic import AFFINES, CAMERA, POSES, Surface, true_window

from ceiling_dso_ros.dso import se3
from ceiling_dso_ros.dso.bundle_adjustment import (
    BundleAdjustment,
    affine_prior,
    marginalize_keyframe,
    null_space,
    solve,
)
from ceiling_dso_ros.dso.config import OptimizationConfig
from ceiling_dso_ros.dso.linearization import Linearization
from ceiling_dso_ros.dso.points import INLIER, NONE, OUTLIER

RELIEF = Surface(slope=(-0.2, 0.1), relief=0.08)
HOLD_FIRST = [4e10] * 3 + [1e11] * 3 + [1e12, 1e8]


def linearized(window):
    result = Linearization(window.keyframes.offset.shape[0], window.points.capacity)
    result.update(window, window.points)
    return result


def hold_first_keyframe(window, intrinsics=1e8):
    window.prior.H[np.arange(4), np.arange(4)] = intrinsics
    window.prior.H[np.arange(4, 12), np.arange(4, 12)] = HOLD_FIRST


def perturb(window, rng, motion=2e-3, depth=0.02):
    """Move all keyframes but the first, and all inverse depths, off the truth; evaluate there."""
    scale = np.concatenate([np.zeros(12), np.tile(np.r_[np.full(6, motion), 0.01, 1.0], window.count - 1)])
    window.move(scale * rng.normal(size=scale.size))
    idepth = window.points.arrays.idepth[: window.points.count]
    idepth *= 1 + depth * rng.normal(size=idepth.size).astype(np.float32)
    for slot in range(window.count):
        window.relinearize(slot)


def relative_poses(T_camera_world):
    """Motion from the first of three cameras to each: what images show of poses, but for the unit of length."""
    return np.array([T_camera_world[k] @ np.linalg.inv(T_camera_world[0]) for k in range(3)])


def scale_of(window):
    """The window's unit of length in the truth's: images do not show it."""
    ours = relative_poses(window.keyframes.T_camera_world)[:, :3, 3].ravel()
    true = relative_poses(POSES)[:, :3, 3].ravel()
    return (ours @ true) / (true @ true)


def errors(window, surface):
    scale = scale_of(window)
    ours = relative_poses(window.keyframes.T_camera_world)
    ours[:, :3, 3] /= scale
    poses = [se3.log(T @ np.linalg.inv(T_true)) for T, T_true in zip(ours, relative_poses(POSES))]
    n = window.points.count
    a = window.points.arrays
    true = np.concatenate([
        surface.idepth(T, a.u[:n][a.host[:n] == h], a.v[:n][a.host[:n] == h]) for h, T in enumerate(POSES)
    ])  # fmt: skip
    seen = a.idepth_hessian[:n] > 500
    return np.array(poses), np.abs(scale * a.idepth[:n] / true - 1)[seen], window.keyframes.affine[:3] - AFFINES


def test_a_perturbed_window_comes_back_to_the_truth():
    window = true_window(200, surface=RELIEF)
    hold_first_keyframe(window)
    perturb(window, np.random.default_rng(0))
    before = errors(window, RELIEF)
    assert np.abs(before[0]).max() > 2e-3  # so that there is something to find
    rmse = BundleAdjustment(window, OptimizationConfig()).optimize(window)
    poses, idepth, affine = errors(window, RELIEF)
    assert rmse < 1.0
    assert np.abs(poses[:, :3]).max() < 3e-4
    assert np.abs(poses[:, 3:]).max() < 2e-4
    assert np.median(idepth) < 2e-3
    assert np.abs(affine[:, 0]).max() < 2e-3
    assert np.abs(affine[:, 1]).max() < 0.3
    assert scale_of(window) == pytest.approx(1.0, abs=0.05)  # held by nothing but the start


def test_wrong_intrinsics_come_back_while_the_prior_is_weak():
    window = true_window(250, surface=RELIEF)
    hold_first_keyframe(window, intrinsics=0.0)
    window.intrinsics_eval = CAMERA.parameters + np.array([3.0, -3.0, 2.0, 2.0])
    adjustment = BundleAdjustment(window, OptimizationConfig())
    for _ in range(3):
        adjustment.optimize(window)
    error = window.intrinsics - CAMERA.parameters
    assert np.abs(error[:2]).max() < 1.5
    assert np.abs(error[2:]).max() < 1.0


def test_the_truth_stays():
    window = true_window(150, surface=RELIEF)
    hold_first_keyframe(window)
    BundleAdjustment(window, OptimizationConfig()).optimize(window)
    poses, idepth, _ = errors(window, RELIEF)
    assert np.abs(poses).max() < 3e-4
    assert np.median(idepth) < 2e-3


def test_same_window_gives_the_same_bytes():
    results = []
    for _ in range(2):
        window = true_window(80, surface=RELIEF)
        hold_first_keyframe(window)
        perturb(window, np.random.default_rng(0))
        BundleAdjustment(window, OptimizationConfig()).optimize(window)
        results.append(window.keyframes.T_camera_world.tobytes() + window.points.arrays.idepth.tobytes())
    assert results[0] == results[1]


def test_only_inliers_stay_and_count_as_good():
    window = true_window(40, surface=RELIEF)
    hold_first_keyframe(window)
    window.points.arrays.grey[:, 3] += np.linspace(-80, 80, 8)  # looks like this nowhere
    BundleAdjustment(window, OptimizationConfig()).optimize(window)
    residuals, count = window.points.residuals, window.points.count
    live, state = residuals.live[:, :count], residuals.state[:, :count]
    assert not live[:, 3].any()
    assert (state[1:3, 3] == OUTLIER).all()
    assert window.points.arrays.good_residuals[3] == 0
    assert (state[live > 0] == INLIER).all()
    assert np.isin(state[live == 0], (NONE, OUTLIER)).all()
    np.testing.assert_array_equal(window.points.arrays.good_residuals[:count], live.sum(axis=0))
    BundleAdjustment(window, OptimizationConfig()).optimize(window)  # counts the newest keyframe's again
    np.testing.assert_array_equal(
        window.points.arrays.good_residuals[:count], live.sum(axis=0) + live[window.newest] * (live.sum(axis=0) > 0)
    )


def test_a_strong_prior_wins_wherever_the_estimate_starts():
    """The minimum of the prior on intrinsics and the older keyframes, whose offsets are not zero at the start."""
    window, rng = true_window(30, surface=RELIEF), np.random.default_rng(0)
    J = rng.normal(size=(60, 20)) * np.r_[np.full(4, 1.0), np.tile([1e3] * 6 + [1e2, 1.0], 2)] * 1e5
    minimum = 1e-3 * rng.normal(size=20)
    window.prior.H[:20, :20] = J.T @ J
    window.prior.b[:20] = -J.T @ J @ minimum
    window.move(np.r_[2e-3 * rng.normal(size=20), np.zeros(8)])
    adjustment = BundleAdjustment(window, OptimizationConfig())
    adjustment.linearization.update(window, window.points)
    step = adjustment._step(window, project=False)
    np.testing.assert_allclose(window.offsets[:20] + step[:20], minimum, atol=1e-4)


def test_later_steps_do_not_move_what_images_cannot_see():
    window = true_window(60, surface=RELIEF)
    hold_first_keyframe(window)
    perturb(window, np.random.default_rng(0))
    adjustment = BundleAdjustment(window, OptimizationConfig())
    adjustment.linearization.update(window, window.points)
    free, projected = (adjustment._step(window, project=project) for project in (False, True))
    basis = null_space(window)
    assert np.linalg.norm(basis.T @ free) > 1e-4
    assert np.linalg.norm(basis.T @ projected) < 1e-12
    np.testing.assert_allclose(projected, free - basis @ (basis.T @ free), atol=1e-12)


def test_an_estimate_that_is_no_number_is_no_error():
    window = true_window(40, surface=RELIEF)
    hold_first_keyframe(window)
    window.prior.b[:] = np.nan
    assert np.isnan(BundleAdjustment(window, OptimizationConfig()).optimize(window))


def test_a_keyframe_that_sees_none_of_the_points_is_no_error():
    window = true_window(40, surface=RELIEF)
    hold_first_keyframe(window)
    window.points.keep(window.points.arrays.host[: window.points.count] != 2)
    window.points.residuals.live[2] = 0
    assert np.isnan(BundleAdjustment(window, OptimizationConfig()).optimize(window))


# The gauge


def energy_after(window, step, shrink=0.0):
    """Energy after a step, with inverse depths divided by (1 + shrink); the window is put back."""
    idepth = window.points.arrays.idepth[: window.points.count]
    before = idepth.copy()
    window.move(step)
    idepth /= np.float32(1 + shrink)
    energy = linearized(window).energy
    window.move(-step)
    idepth[:] = before
    return energy


def test_null_space_leaves_the_energy_unchanged():
    window = true_window(150, surface=RELIEF)
    window.move(np.concatenate([np.zeros(4), np.tile(np.r_[np.full(6, 1e-3), 0, 0], 3)]) * np.arange(28) / 28)
    for slot in range(3):
        window.relinearize(slot)
    basis = null_space(window)
    assert basis.shape == (28, 7)
    np.testing.assert_allclose(basis.T @ basis, np.eye(7), atol=1e-12)
    energy = linearized(window).energy
    size = 0.01
    rng = np.random.default_rng(0)

    scale_direction = np.zeros(28)
    for slot in range(3):
        scale_direction[4 + 8 * slot : 7 + 8 * slot] = window.keyframes.T_camera_world[slot][:3, 3]
    scale_direction *= size / np.linalg.norm(scale_direction)
    shrink = np.linalg.norm(scale_direction) / np.linalg.norm(
        [window.keyframes.T_camera_world[s][:3, 3] for s in range(3)]
    )
    np.testing.assert_allclose(basis @ (basis.T @ scale_direction), scale_direction, atol=1e-12)
    along = abs(energy_after(window, scale_direction, shrink) - energy)
    assert along < 0.05 * energy

    for _ in range(5):
        twist = rng.normal(size=6)  # of the world: T_camera_world exp(twist)
        free = np.zeros(28)
        for slot in range(3):
            free[4 + 8 * slot : 10 + 8 * slot] = se3.adjoint(window.keyframes.T_camera_world[slot]) @ twist
        free *= size / np.linalg.norm(free)
        np.testing.assert_allclose(basis @ (basis.T @ free), free, atol=1e-12)
        seen = rng.normal(size=28) * (np.abs(basis).sum(axis=1) > 1e-9)
        seen -= basis @ (basis.T @ seen)
        seen *= size / np.linalg.norm(seen)
        changes = [abs(energy_after(window, step) - energy) for step in (free, seen)]
        assert changes[0] < 0.01 * changes[1]


def test_null_space_is_that_of_the_hessian():
    window = true_window(150, surface=RELIEF)
    H = linearized(window).H
    basis = null_space(window)
    scale = np.sqrt(np.diag(H))
    for column in basis.T:
        assert column @ H @ column < 1e-4 * ((scale * column) ** 2).sum()


def test_solve():
    rng = np.random.default_rng(0)
    J = rng.normal(size=(60, 12)) * 10.0 ** rng.uniform(1, 5, 12)
    H, x = J.T @ J, rng.normal(size=12) / np.linalg.norm(J, axis=0)
    np.testing.assert_allclose(solve(H, -H @ x), x, atol=1e-3 * np.abs(x).max(), rtol=1e-2)


def test_no_step_where_rounding_left_less_than_nothing():
    """The first two keyframes of a sideways motion: its length sets the unit, and the Schur complement cancels."""
    H = np.diag([4e10, -1024.0, 7e8])
    np.testing.assert_allclose(solve(H, np.array([4e10, 500.0, -7e8])), [-1.0, 0.0, 1.0], rtol=1e-4)


# Marginalisation


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
