# SPDX-License-Identifier: BSD-3-Clause
"""Normal equations of a window against a dense reference in float64 and against numeric differences of the energy."""

import numpy as np
import pytest
from samples import sample
from synthetic import EXPOSURES, POSES, add_keyframe, add_points, empty_window, linearized, random_pixels, true_window

from ceiling_dso_ros.dso.adjustment.linearization import (
    linearize_host,
    scratch_memory,
)
from ceiling_dso_ros.dso.adjustment.reduction_kernels import relative_step, to_absolute
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.images.pattern import PATTERN_X, PATTERN_Y
from ceiling_dso_ros.dso.window.pair_geometry import pair_geometry
from ceiling_dso_ros.dso.window.points import INLIER, NONE, OUT_OF_BOUNDS, OUTLIER

SIZE = 28  # 4 intrinsics and 3 keyframes of 8
STEP = np.concatenate([np.full(4, 0.05), np.tile(np.r_[np.full(6, 2e-4), 1e-3, 0.05], 3)])  # for numeric differences
KEYFRAMES = [4, 12, 20]


def perturb(window, seed=0, size=1.0):
    """Move everything a little, so that residuals, offsets and gradients are not zero."""
    rng = np.random.default_rng(seed)
    scale = np.concatenate([np.full(4, 0.3), np.tile(np.r_[np.full(6, 1e-3), 0.005, 0.5], 3)])
    window.move(size * scale * rng.normal(size=SIZE))
    idepth = window.points.arrays.idepth[: window.points.count]
    idepth *= 1 + 0.003 * size * rng.normal(size=idepth.size).astype(np.float32)


def relinearize(window):
    for slot in range(window.count):
        window.relinearize(slot)
    window.intrinsics_eval, window.intrinsics_offset = window.intrinsics, np.zeros(4)


def relative_by_absolute(host, n, pairs):
    """Derivative of (intrinsics, relative parameters of a host) by (intrinsics, keyframes), (SIZE, SIZE)."""
    return np.stack([relative_step(host, n, pairs, column) for column in np.eye(SIZE)], axis=1)


def blocks(window):
    """H, b of (intrinsics, keyframes), the inverse depths' H and b, and the mixed block: nothing eliminated yet."""
    n, count = window.count, window.points.count
    points, residuals = window.points.arrays, window.points.residuals
    ranges, pairs = window.points.host_ranges(n), pair_geometry(window.keyframes, n, window.intrinsics)
    scratch = scratch_memory(window.keyframes.offset.shape[0], window.points.capacity)
    H, b, mixed = np.zeros((SIZE, SIZE)), np.zeros(SIZE), np.zeros((SIZE, count))
    for host in range(n):
        first, last = ranges[host], ranges[host + 1]
        system = np.empty((SIZE + 1, SIZE + 1))
        linearize_host(
            host, n, first, last, points, residuals, window.keyframes, pairs, window.pool.buffers,
            window.width, window.height, window.intrinsics.astype(np.float32), scratch, system,
        )  # fmt: skip
        B = relative_by_absolute(host, n, pairs)
        H += B.T @ system[:SIZE, :SIZE] @ B
        b += B.T @ system[:SIZE, SIZE]
        rows = np.zeros((SIZE, last - first))
        rows[:4] = points.idepth_intrinsics[:, first:last]
        for target in range(n):
            if target != host:
                rows[4 + 8 * target : 12 + 8 * target] = residuals.idepth_relative[target, :, first:last]
        mixed[:, first:last] = B.T @ rows
    return H, b, points.idepth_hessian[:count].astype(float), points.idepth_gradient[:count].astype(float), mixed


def project(u, v, idepth, intrinsics, T):
    fx, fy, cx, cy = intrinsics
    ray = np.stack([(u - cx) / fx, (v - cy) / fy, np.ones_like(u)])
    x, y, z = T[:3, :3] @ ray + T[:3, 3:] * idepth
    return np.stack([fx * x / z + cx, fy * y / z + cy])


class DenseReference:
    """Residuals, weights and first-estimate Jacobian of a window, one row per pixel of a live inlier, in float64.

    Geometry is differentiated numerically at the evaluation point and at the centre of the pattern, which all its
    pixels share; the image gradient is taken at the current estimate.
    """

    def __init__(self, window):
        self.window = window
        points, residuals = window.points.arrays, window.points.residuals
        rows, self.r, self.w = [], [], []
        for i in range(window.points.count):
            for target in range(window.count):
                if residuals.live[target, i] and residuals.state[target, i] == INLIER:
                    self.add(i, int(points.host[i]), target, rows)
        self.J, self.r, self.w = np.concatenate(rows), np.concatenate(self.r), np.concatenate(self.w)

    def pixels(self, i, host, target, offset, du, dv, d_idepth, at_evaluation_point):
        points, frames = self.window.points.arrays, self.window.keyframes
        if at_evaluation_point:
            T_host, T_target = frames.T_camera_world_eval[host], frames.T_camera_world_eval[target]
        else:
            T_host, T_target = frames.T_camera_world[host], frames.T_camera_world[target]
        h, t = 4 + 8 * host, 4 + 8 * target
        T = se3.exp(offset[t : t + 6]) @ T_target @ np.linalg.inv(se3.exp(offset[h : h + 6]) @ T_host)
        u, v = (np.asarray(a[i] + d, float) for a, d in ((points.u, du), (points.v, dv)))
        return project(u, v, float(points.idepth[i]) + d_idepth, self.window.intrinsics + offset[:4], T)

    def add(self, i, host, target, rows):
        window, frames, count = self.window, self.window.keyframes, self.window.points.count
        image = window.image(target).reshape(window.height, window.width)
        value, gx, gy = sample(image, *self.pixels(i, host, target, np.zeros(SIZE), PATTERN_X, PATTERN_Y, 0.0, False))
        grey, weight_host = (a[:, i].astype(float) for a in (window.points.arrays.grey, window.points.arrays.weight))
        ratio = frames.exposure[target] / frames.exposure[host]
        gain = ratio * np.exp(frames.affine[target, 0] - frames.affine[host, 0])
        residual = value - frames.affine[target, 1] - gain * (grey - frames.affine[host, 1])
        weight = 0.5 * (weight_host + np.sqrt(2500 / (2500 + gx**2 + gy**2)))
        self.r.append(residual)
        self.w.append(weight**2 * 9 / np.maximum(np.abs(residual), 9))

        geometry, h = np.zeros((2, SIZE + count)), 1e-6
        zero = np.zeros(1)
        involved = [*range(4), *range(4 + 8 * host, 10 + 8 * host), *range(4 + 8 * target, 10 + 8 * target)]
        for c in involved:
            plus, minus = (
                self.pixels(i, host, target, s * h * np.eye(SIZE)[c], zero, zero, 0.0, True) for s in (1, -1)
            )
            geometry[:, c] = (plus - minus)[:, 0] / (2 * h)
        plus, minus = (self.pixels(i, host, target, np.zeros(SIZE), zero, zero, s * h, True) for s in (1, -1))
        geometry[:, SIZE + i] = (plus - minus)[:, 0] / (2 * h)
        J = gx[:, None] * geometry[0] + gy[:, None] * geometry[1]
        gain_eval = ratio * np.exp(frames.affine_eval[target, 0] - frames.affine_eval[host, 0])
        light = gain_eval * (grey - frames.affine_eval[host, 1])
        J[:, 10 + 8 * target], J[:, 11 + 8 * target] = -light, -1.0
        J[:, 10 + 8 * host], J[:, 11 + 8 * host] = light, gain_eval
        rows.append(J)

    def normal_equations(self):
        WJ = self.w[:, None] * self.J
        return self.J.T @ WJ, WJ.T @ self.r


def test_normal_equations_are_those_of_the_dense_reference():
    """Away from the evaluation point: the geometry's Jacobians stay there, image gradients and residuals do not."""
    window = true_window(12)
    perturb(window, size=3.0)
    linearized(window)  # decides which residuals are inliers
    H, b, H_depth, b_depth, mixed = blocks(window)
    H_dense, b_dense = DenseReference(window).normal_equations()
    scale = np.sqrt(np.maximum(np.diag(H_dense), 1.0))
    H_ours = np.block([[H, mixed], [mixed.T, np.diag(H_depth)]])
    np.testing.assert_allclose(H_ours / np.outer(scale, scale), H_dense / np.outer(scale, scale), atol=1e-4)
    np.testing.assert_allclose(np.concatenate([b, b_depth]) / scale, b_dense / scale, atol=2e-3)
    assert np.abs(b_dense / scale).max() > 1  # or the comparison would say nothing


def energy_after(window, step):
    window.move(step)
    energy = linearized(window).energy
    window.move(-step)
    return energy


@pytest.fixture(scope="module")
def perturbed():
    """A window evaluated at its estimate, away from the truth."""
    window = true_window(150)
    perturb(window)
    relinearize(window)
    return window


def test_gradient_is_that_of_the_energy(perturbed):
    """Up to what the method neglects: the change of the weights, and of the geometry within the pattern."""
    linearized(perturbed)
    _, b, _, b_depth, _ = blocks(perturbed)
    numeric = np.array(
        [
            (energy_after(perturbed, s * e) - energy_after(perturbed, -s * e)) / (2 * s) / 2
            for s, e in zip(STEP, np.eye(SIZE))
        ]
    )
    for first, width in ((0, 2), (2, 2), *((k + o, w) for k in KEYFRAMES for o, w in ((0, 3), (3, 3), (6, 1), (7, 1)))):
        part = slice(first, first + width)
        error = np.linalg.norm(b[part] - numeric[part])
        assert error < 0.05 * np.linalg.norm(numeric[part]) + 0.002 * np.linalg.norm(b[part] / STEP[part]), part
    assert b @ numeric / np.linalg.norm(b) / np.linalg.norm(numeric) > 0.999

    idepth = perturbed.points.arrays.idepth
    chosen = np.argsort(-np.abs(b_depth))[:40]
    numeric = []
    for i in chosen:
        before, energies = idepth[i], []
        for s in (1e-3, -1e-3):
            idepth[i] = before + s
            energies.append(linearized(perturbed).energy)
        idepth[i] = before
        numeric.append((energies[0] - energies[1]) / 2e-3 / 2)
    assert np.median(np.abs(b_depth[chosen] / numeric - 1)) < 0.05
    assert np.abs(b_depth[chosen] / numeric - 1).max() < 0.4


def test_hessian_predicts_the_change_of_the_gradient(perturbed):
    """Gauss-Newton: for small residuals H is the derivative of b, within what the texture's curvature adds."""
    window = true_window(150)
    linearized(window)
    H = blocks(window)[0]
    columns = []
    for s, e in zip(STEP, np.eye(SIZE)):
        gradients = []
        for sign in (1, -1):
            window.move(sign * s * e)
            gradients.append(blocks(window)[1])
            window.move(-sign * s * e)
        columns.append((gradients[0] - gradients[1]) / (2 * s))
    numeric = np.stack(columns, axis=1)
    scale = np.sqrt(np.diag(H))
    np.testing.assert_allclose(numeric / np.outer(scale, scale), H / np.outer(scale, scale), atol=0.03)


def test_reduced_system_with_back_substitution_is_the_full_solution(perturbed):
    reduced = linearized(perturbed)
    H, b, H_depth, b_depth, mixed = blocks(perturbed)
    informative = H_depth > 0
    assert informative.sum() > 400
    H_depth, b_depth, mixed = H_depth[informative], b_depth[informative], mixed[:, informative]
    prior = np.diag(1e-3 * np.diag(H))  # the gauge is free: without a prior there is no single solution
    full = np.block([[H + prior, mixed], [mixed.T, np.diag(H_depth)]])
    solution = -np.linalg.solve(full, np.concatenate([b, b_depth]))
    step = -np.linalg.solve(reduced.H + prior, reduced.b)
    scale = np.sqrt(np.diag(H))
    np.testing.assert_allclose(reduced.H, reduced.H.T, atol=1e-9 * scale.max() ** 2)
    np.testing.assert_allclose(step * scale, solution[:SIZE] * scale, atol=2e-3 * np.abs(solution[:SIZE] * scale).max())
    ours = reduced.idepth_steps(perturbed, solution[:SIZE])
    np.testing.assert_allclose(ours[informative], solution[SIZE:], atol=1e-3 * np.abs(solution[SIZE:]).max())
    assert not ours[~informative].any()


def test_reduced_system_is_the_schur_complement(perturbed):
    reduced = linearized(perturbed)
    H, b, H_depth, b_depth, mixed = blocks(perturbed)
    scale, inverse = np.sqrt(np.diag(H)), 1.0 / np.where(H_depth > 0, H_depth, np.inf)
    expected = H - (mixed * inverse) @ mixed.T
    np.testing.assert_allclose(reduced.H / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-5)
    np.testing.assert_allclose(reduced.b / scale, (b - mixed @ (b_depth * inverse)) / scale, atol=1e-3)


def test_energy_at_the_truth_is_next_to_nothing():
    window = true_window(100)
    result = linearized(window)
    inlier = window.points.residuals.state[:3, :300] == INLIER
    assert result.count == 600
    assert inlier.sum() > 580  # the others lie where the texture is flat
    energy = window.points.residuals.energy[:3, :300]
    assert np.sqrt(energy[inlier].mean() / 8) < 0.2
    perturb(window)
    linearized(window)
    assert np.sqrt(energy[inlier].mean() / 8) > 1.0


def test_states_of_residuals():
    """Inlier, outlier, out of the image, not live: energies and counts follow."""
    window = true_window(20)
    window.points.arrays.grey[:, 3] += 60  # another brightness than anything the targets show
    window.points.arrays.idepth[5] = 30.0  # far out of the image
    window.points.residuals.live[1, 7], window.points.residuals.state[1, 7] = 0, NONE
    result = linearized(window)
    state, energy = window.points.residuals.state, window.points.residuals.energy
    assert state[1:3, 3].tolist() == [OUTLIER] * 2
    assert state[1:3, 5].tolist() == [OUT_OF_BOUNDS] * 2
    assert state[1, 7] == NONE
    assert state[2, 7] == INLIER
    assert result.count == 120 - 2 - 1
    outliers = 512.0 * (state[:3, :60] == OUTLIER).sum()
    assert result.energy == pytest.approx(energy[:3, :60][state[:3, :60] == INLIER].sum() + outliers, rel=1e-4)
    assert window.points.arrays.idepth_hessian[3] == 0  # outliers give no information
    assert window.points.arrays.idepth_hessian[4] > 0


def test_a_featureless_residual_is_an_outlier():
    window = empty_window()
    for T in POSES[:2]:
        slot = window.pool.build(np.full((240, 320), 100, np.float32))
        window.add_keyframe(window.count, 0, slot, T, np.zeros(2), 1.0)
    u, v = random_pixels(np.random.default_rng(0), 10)
    add_points(window, 0, u, v, np.ones(10))
    result = linearized(window)
    assert (window.points.residuals.state[1, :10] == OUTLIER).all()
    assert not result.H.any()
    assert not linearized(window).idepth_steps(window, np.zeros(20)).any()


def test_a_keyframe_without_points_and_an_empty_window():
    window = empty_window()
    for T in POSES:
        add_keyframe(window, T)
    assert not linearized(window).H.any()
    u, v = random_pixels(np.random.default_rng(0), 10)
    add_points(window, 1, u, v, np.ones(10))
    assert linearized(window).count == 20


def test_rows_go_to_absolute_parameters_by_the_transposed_derivative(perturbed):
    pairs = pair_geometry(perturbed.keyframes, 3, perturbed.intrinsics)
    rows = np.random.default_rng(0).normal(size=(SIZE, 5))
    for host in range(3):
        own = slice(4 + 8 * host, 12 + 8 * host)  # a host has no residual into itself: those rows are empty
        rows[own] = 0.0
        expected = relative_by_absolute(host, 3, pairs).T @ rows
        np.testing.assert_allclose(to_absolute(host, 3, pairs, rows), expected, atol=1e-12)


def test_brightness_columns_follow_the_definition(perturbed):
    """Numeric derivative of gain and offset of the pairs by (a, b) of host and target."""
    pairs = pair_geometry(perturbed.keyframes, 3, perturbed.intrinsics)
    B = relative_by_absolute(0, 3, pairs)
    grey = 130.0
    d = grey - perturbed.keyframes.affine_eval[0, 1]
    for column in (10, 11, 18, 19):
        h, e = 1e-3, np.eye(SIZE)[column]
        residuals = []
        for s in (h, -h):
            perturbed.move(s * e)
            moved = pair_geometry(perturbed.keyframes, 3, perturbed.intrinsics)
            residuals.append(-float(moved.gain[0, 1]) * grey - float(moved.offset[0, 1]))
            perturbed.move(-s * e)
        numeric = (residuals[0] - residuals[1]) / (2 * h)
        assert B[18, column] * d + B[19, column] == pytest.approx(numeric, rel=0.02, abs=0.02)
    assert EXPOSURES[0] != EXPOSURES[1]  # so that the gain is not one


def test_an_assessment_sees_what_a_linearization_sees_and_leaves_the_rest():
    window = true_window()
    perturb(window)
    found = linearized(window)
    residuals, count = window.points.residuals, window.points.count
    perturb(window, seed=1, size=5.0)
    H, hessian = found.H.copy(), window.points.arrays.idepth_hessian[:count].copy()
    found.assess(window, window.points)
    np.testing.assert_array_equal(found.H, H)
    np.testing.assert_array_equal(window.points.arrays.idepth_hessian[:count], hessian)
    state, energy = residuals.state[:, :count].copy(), residuals.energy[:, :count].copy()
    assert set(np.unique(state[: window.count])) >= {INLIER, OUTLIER}
    other = linearized(window)
    assert found.energy == other.energy
    assert found.count == other.count
    np.testing.assert_array_equal(residuals.state[:, :count], state)
    np.testing.assert_array_equal(residuals.energy[:, :count], energy)
