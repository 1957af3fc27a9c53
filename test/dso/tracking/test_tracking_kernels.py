# SPDX-License-Identifier: BSD-3-Clause
"""The tracker's normal equations against numeric differences, and alignment of single levels."""

import numpy as np
import pytest
from samples import sample
from synthetic import CAMERA, POSES, Surface, random_pixels

from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.tracking.tracking_kernels import accumulate, align, mean_squared_flow

SURFACE = Surface(slope=(-0.2, 0.1), relief=0.05)
REFERENCE_AFFINE = np.array([0.1, 4.0])
RATIO = 1.2
AFFINE = np.array([0.25, -3.0])
T_TRUE = POSES[1]
WRONG = se3.exp(np.array([0.004, -0.003, 0.005, 0.002, 0.003, -0.004]))


def reference_points(n=2000):
    u, v = random_pixels(np.random.default_rng(0), n, border=10)
    grey, idepth = SURFACE.look(np.eye(4), CAMERA.parameters, u.astype(float), v.astype(float))
    grey = np.exp(REFERENCE_AFFINE[0]) * grey + REFERENCE_AFFINE[1]
    return u, v, idepth.astype(np.float32), grey.astype(np.float32)


IMAGE = SURFACE.render(T_TRUE, CAMERA, AFFINE, RATIO)
POINTS = reference_points()


def project(T, intrinsics=CAMERA.parameters):
    u, v, idepth, _ = (a.astype(float) for a in POINTS)
    fx, fy, cx, cy = intrinsics
    x, y, z = T[:3, :3] @ np.stack([(u - cx) / fx, (v - cy) / fy, np.ones_like(u)]) + T[:3, 3:] * idepth
    return np.stack([fx * x / z + cx, fy * y / z + cy])


def system_at(T, affine, cutoff=1000.0):
    system = np.zeros((9, 9))
    gain = RATIO * np.exp(affine[0] - REFERENCE_AFFINE[0])
    result = accumulate(
        *POINTS, IMAGE.ravel(), 320, 240, CAMERA.parameters, T, gain, REFERENCE_AFFINE[1], affine[1], cutoff, system
    )  # fmt: skip
    return result, np.triu(system) + np.triu(system, 1).T


def dense(T, affine):
    """Jacobian (numeric for the geometry), residuals and Huber weights of points in view, float64."""
    at = project(T)
    value, gx, gy = sample(IMAGE, *at)
    grey = POINTS[3].astype(float)
    light = RATIO * np.exp(affine[0] - REFERENCE_AFFINE[0]) * (grey - REFERENCE_AFFINE[1])
    residual, h = value - affine[1] - light, 1e-6
    columns = []
    for e in np.eye(6):
        shift = (project(se3.exp(h * e) @ T) - project(se3.exp(-h * e) @ T)) / (2 * h)
        columns.append(gx * shift[0] + gy * shift[1])
    J = np.stack([*columns, -light, -np.ones_like(light)], axis=1)
    inside = (at[0] > 2) & (at[1] > 2) & (at[0] < 317) & (at[1] < 237)
    return J[inside], residual[inside], (9 / np.maximum(np.abs(residual), 9))[inside]


@pytest.mark.parametrize("affine", [AFFINE, AFFINE + np.array([0.05, -12.0])])
def test_normal_equations(affine):
    T = WRONG @ T_TRUE
    J, residual, weight = dense(T, affine)
    full = np.hstack([J, residual[:, None]])
    expected = full.T @ (weight[:, None] * full)
    (energy, in_view, saturated), system = system_at(T, affine)
    assert in_view == residual.size
    assert saturated == 0
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(system / np.outer(scale, scale), expected / np.outer(scale, scale), atol=2e-4)
    size = np.abs(residual)
    assert energy == pytest.approx(np.where(size < 9, size**2, 18 * size - 81).sum(), rel=1e-3)


def test_gradient_is_that_of_the_energy():
    T, affine = WRONG @ T_TRUE, AFFINE + np.array([0.02, -3.0])
    _, system = system_at(T, affine)
    for c, h in enumerate([2e-4] * 6 + [1e-3, 0.05]):
        e = np.zeros(8)
        e[c] = h
        plus, minus = (system_at(se3.exp(s * e[:6]) @ T, affine + s * e[6:])[0][0] for s in (1, -1))
        numeric = (plus - minus) / (2 * h) / 2
        assert system[c, 8] == pytest.approx(numeric, rel=0.03, abs=0.003 * np.sqrt(system[c, c] * system[8, 8]))


def test_saturated_points_add_energy_and_no_information():
    (energy, in_view, saturated), system = system_at(T_TRUE, AFFINE + np.array([0.0, 100.0]), cutoff=20.0)
    assert saturated == in_view > 0
    assert energy == pytest.approx(in_view * (2 * 9 * 20 - 81), rel=1e-4)
    assert not system.any()


def aligned(T, affine, iterations=50, prior=(0.0, 0.0), cutoff=20.0, image=IMAGE):
    system = np.zeros((9, 9))
    return align(
        *POINTS, np.ascontiguousarray(image, np.float32).ravel(), 320, 240, CAMERA.parameters, T, np.array(affine),
        REFERENCE_AFFINE, RATIO, np.array(prior), cutoff, iterations, 1e-5, system,
    )  # fmt: skip


def test_align_recovers_motion_and_brightness():
    T, affine, rmse, saturated = aligned(WRONG @ T_TRUE, AFFINE + np.array([0.03, 2.0]))
    assert np.abs(se3.log(T @ np.linalg.inv(T_TRUE))).max() < 1e-4
    assert affine[0] == pytest.approx(AFFINE[0], abs=3e-3)
    grey = np.array([60.0, 120.0, 180.0])  # a and b pull at each other: what counts is the grey that they give
    ours, true = (RATIO * np.exp(a) * grey + b for a, b in (affine, AFFINE))
    assert ours == pytest.approx(true, abs=0.3)
    assert rmse < 0.3
    assert saturated == 0


def test_align_never_gets_worse_and_returns_its_own_error():
    start = WRONG @ WRONG @ T_TRUE
    errors = [aligned(start, AFFINE, iterations)[2] for iterations in (0, 1, 2, 5, 10)]
    assert errors == sorted(errors, reverse=True)
    T, affine, rmse, _ = aligned(start, AFFINE, 2)
    (energy, in_view, _), _ = system_at(T, affine, 20.0)
    assert rmse == pytest.approx(np.sqrt(energy / in_view), rel=1e-6)


def test_a_strong_prior_keeps_the_brightness_of_the_reference():
    _, affine, _, _ = aligned(T_TRUE, REFERENCE_AFFINE, prior=(1e12, 1e12))
    np.testing.assert_allclose(affine, REFERENCE_AFFINE, atol=1e-4)


def test_nothing_in_view_is_an_infinite_error():
    T, affine, rmse, saturated = aligned(se3.exp(np.array([0, 0, 0, 0, 2.0, 0])), AFFINE)
    assert rmse == np.inf
    assert saturated == 1.0
    assert np.isfinite(T).all()
    assert affine.tolist() == AFFINE.tolist()


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_garbage_images_do_not_pass_for_a_match(value):
    _, _, rmse, saturated = aligned(T_TRUE, AFFINE, image=np.full((240, 320), value))
    assert saturated == 1.0 or not np.isfinite(rmse)


def test_flow_is_that_of_the_projections():
    T = se3.exp(np.array([0.06, -0.03, 0.02, 0.01, 0.02, 0.1]))
    by_translation, by_motion = mean_squared_flow(*POINTS[:3], CAMERA.parameters, T)
    only_translation = np.eye(4)
    only_translation[:3, 3] = T[:3, 3]
    at = np.stack(POINTS[:2])
    for flow, motion in ((by_translation, only_translation), (by_motion, T)):
        assert flow == pytest.approx(((project(motion) - at) ** 2).sum(axis=0).mean(), rel=1e-4)
    assert mean_squared_flow(*POINTS[:3], CAMERA.parameters, np.eye(4)) == pytest.approx((0, 0), abs=1e-6)
    nothing = np.zeros(0, np.float32)
    assert mean_squared_flow(nothing, nothing, nothing, CAMERA.parameters, T) == (0, 0)
