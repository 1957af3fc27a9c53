# SPDX-License-Identifier: BSD-3-Clause
"""Bundle adjustment finds the truth again, and does not move what images cannot see."""

import numpy as np
import pytest
from synthetic import AFFINES, CAMERA, EXPOSURES, POSES, RELIEF, hold_first_keyframe, linearized, true_window

from ceiling_dso_ros.dso.adjustment.bundle_adjustment import BundleAdjustment, null_space, solve, unit_direction, unseen
from ceiling_dso_ros.dso.config import OptimizationConfig
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.window.points import INLIER, NONE, OUTLIER


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
    step = adjustment._step(window, np.zeros((28, 0)))
    np.testing.assert_allclose(window.offsets[:20] + step[:20], minimum, atol=1e-4)


def test_later_steps_do_not_move_what_images_cannot_see():
    window = true_window(60, surface=RELIEF)
    hold_first_keyframe(window)
    perturb(window, np.random.default_rng(0))
    adjustment = BundleAdjustment(window, OptimizationConfig())
    adjustment.linearization.update(window, window.points)
    basis = null_space(window)
    free = adjustment._step(window, np.zeros((28, 0)))
    projected = adjustment._step(window, unseen(window, first=False))
    assert np.linalg.norm(basis.T @ free) > 1e-4
    assert np.linalg.norm(basis.T @ projected) < 1e-12
    np.testing.assert_allclose(projected, free - basis @ (basis.T @ free), atol=1e-12)


def test_until_points_were_marginalised_no_step_changes_the_unit_of_length():
    """Two keyframes do not tell it, so that rounding may have the first step double the way between them."""
    window = true_window(60, surface=RELIEF, poses=POSES[:2], affines=AFFINES[:2], exposures=EXPOSURES[:2])
    hold_first_keyframe(window)
    perturb(window, np.random.default_rng(0))
    adjustment = BundleAdjustment(window, OptimizationConfig())
    adjustment.linearization.update(window, window.points)
    window.prior.b[12:15] = 1e-3 * window.keyframes.T_camera_world[1, :3, 3]  # as rounding may
    unit = unit_direction(window)
    assert abs(float(unit.T @ adjustment._step(window, np.zeros((20, 0))))) > 1e-3
    assert abs(float(unit.T @ adjustment._step(window, unseen(window, first=True)))) < 1e-12
    adjustment.marginalize_points(window, np.arange(window.points.count) < 10)
    assert unseen(window, first=True).size == 0


def test_the_unit_of_length_is_among_what_images_cannot_see():
    window = true_window(20, surface=RELIEF)
    unit, basis = unit_direction(window), null_space(window)
    assert np.linalg.norm(unit) == pytest.approx(1.0)
    np.testing.assert_allclose(unit, basis @ (basis.T @ unit), atol=1e-9)
    np.testing.assert_allclose(unit[4:12], 0.0, atol=1e-12)  # the oldest keyframe stays


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
