# SPDX-License-Identifier: BSD-3-Clause
"""The covariance of a pose: against numeric derivatives, and with texture in one direction only."""

import numpy as np
import pytest

from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.tracking.uncertainty import (
    CORRELATION,
    GRADIENT_NOISE,
    Observability,
    map_error,
    unit_information,
    world_covariance,
)

INTRINSICS = np.array([200.0, 210.0, 160.0, 118.0])
T = se3.exp(np.array([0.05, -0.1, 0.08, 0.02, -0.03, 0.2]))


def points(n=200):
    rng = np.random.default_rng(0)
    u, v = rng.uniform(20, 300, n).astype(np.float32), rng.uniform(20, 220, n).astype(np.float32)
    return u, v, rng.uniform(0.5, 1.5, n).astype(np.float32)


def pixel_derivatives(u, v, idepth):
    """d pixel / d (translation, rotation) of a left increment on T, (2, 6, n), by central differences."""
    rays = np.stack([(u - INTRINSICS[2]) / INTRINSICS[0], (v - INTRINSICS[3]) / INTRINSICS[1], np.ones_like(u)])

    def project(pose):
        x, y, z = pose[:3, :3] @ rays.astype(float) + pose[:3, 3:] * idepth
        return np.stack([INTRINSICS[0] * x / z, INTRINSICS[1] * y / z])

    h = 1e-5
    return np.stack([(project(se3.exp(h * e) @ T) - project(se3.exp(-h * e) @ T)) / (2 * h) for e in np.eye(6)], axis=1)


def test_unit_information_is_the_square_of_the_pixels_derivative():
    K = pixel_derivatives(*points())
    expected = np.einsum("kan,kbn->ab", K, K)
    np.testing.assert_allclose(unit_information(*points(), INTRINSICS, T), expected, rtol=1e-4, atol=1e-2)


def information(gradients, K):
    rows = np.einsum("kn,kan->an", gradients, K)
    return rows @ rows.T


def test_texture_in_all_directions_gives_the_usual_covariance():
    K = pixel_derivatives(*points())
    H = information(np.random.default_rng(1).normal(0, 30.0, (2, 200)), K)
    seen = Observability.of(H, unit_information(*points(), INTRINSICS, T), rmse=1.0)
    np.testing.assert_allclose(seen.covariance(1.0) @ H / CORRELATION, np.eye(6), atol=0.01)
    assert seen.weakest > 1000
    assert list(seen.gradients) == sorted(seen.gradients)


def test_what_noise_seems_to_tell_is_not_believed():
    """All gradients point in x but for noise: motion along y, and with it rotation about x, is unknown."""
    K, rng = pixel_derivatives(*points()), np.random.default_rng(2)
    rmse = 3.0
    noise = np.sqrt(GRADIENT_NOISE) * rmse
    gradients = np.stack([rng.normal(0, 30.0, 200), np.zeros(200)]) + rng.normal(0, noise, (2, 200))
    H = information(gradients, K)
    seen = Observability.of(H, unit_information(*points(), INTRINSICS, T), rmse)
    assert seen.weakest < 1.5
    believed = CORRELATION * rmse**2 * np.linalg.inv(H)
    assert np.linalg.eigvalsh(seen.covariance(rmse))[-1] > 3 * np.linalg.eigvalsh(believed)[-1]


def test_no_points_and_no_noise_are_finite():
    nothing = Observability.of(np.zeros((6, 6)), np.eye(6), rmse=2.0)
    assert np.isfinite(nothing.covariance(2.0)).all()
    assert nothing.weakest == 0
    assert Observability.of(np.eye(6), np.eye(6), rmse=0.0).weakest == np.inf


def test_covariance_of_the_inverse_pose():
    """The increment of the tracking is one on T_camera_world; its effect on the inverse is taken numerically."""
    T_camera_world = T @ se3.exp(np.array([0.5, -1.0, 2.0, 0.3, -0.2, 0.8]))
    h = 1e-6
    J = np.stack(
        [se3.log(np.linalg.inv(se3.exp(h * e) @ T_camera_world) @ T_camera_world) / h for e in np.eye(6)], axis=1
    )
    A = np.random.default_rng(3).normal(size=(6, 6))
    covariance = A @ A.T
    assert world_covariance(covariance, T_camera_world) == pytest.approx(J @ covariance @ J.T, rel=1e-3, abs=1e-3)


def test_the_first_maps_error_counts_less_with_every_keyframe_and_nothing_in_the_end():
    factors = [map_error(age) for age in range(40)]
    assert factors == sorted(factors, reverse=True)
    assert factors[0] > 10.0
    assert factors[-1] == pytest.approx(1.0, abs=1e-2)
