# SPDX-License-Identifier: BSD-3-Clause
"""A predicted motion's alternatives lie where its covariance says."""

import numpy as np
import pytest

from ceiling_dso_ros.dso import CameraMotion
from ceiling_dso_ros.dso.geometry import se3

T = se3.exp(np.array([0.1, -0.02, 0.0, 0.01, 0.0, 0.3]))


def test_alternatives_are_two_sigma_away_the_widest_first():
    sigma = np.array([0.05, 0.02, 0.01, 0.03, 0.04, 0.2])
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(6, 6)))[0]
    covariance = turn @ np.diag(sigma**2) @ turn.T
    errors = np.array([se3.log(other @ se3.inverse(T)) for other in CameraMotion(T, covariance).alternatives()])
    assert len(errors) == 12
    mahalanobis2 = np.einsum("ij,jk,ik->i", errors, np.linalg.inv(covariance), errors)
    np.testing.assert_allclose(mahalanobis2, 4.0, rtol=1e-6)
    np.testing.assert_allclose(errors[::2], -errors[1::2], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(errors[::2], axis=1), 2.0 * np.sort(sigma)[::-1], rtol=1e-6)


def test_a_scale_hardly_known_leads_to_a_shorter_and_a_longer_way():
    way = np.array([0.3, 0.1, 0.0])
    motion = CameraMotion(se3.exp(np.array([*way, 0, 0, 0])), np.zeros((6, 6)))
    motion.covariance[:3, :3] = 0.2**2 * np.outer(way, way)
    ways = np.array([other[:3, 3] for other in motion.alternatives()])
    np.testing.assert_allclose(sorted(ways, key=np.linalg.norm), [0.6 * way, 1.4 * way], atol=1e-9)


@pytest.mark.parametrize("sigma", [0.0, 1e-3])
def test_what_is_known_well_has_none(sigma):
    assert list(CameraMotion(T, sigma**2 * np.eye(6)).alternatives()) == []
