# SPDX-License-Identifier: BSD-3-Clause
"""Changes of the method: each reaches the code that it is about."""

import numpy as np
import pytest
from support.method_changes import CHANGES

from ceiling_dso_ros.dso.adjustment import linearization, residual_kernels
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.images import pattern
from ceiling_dso_ros.dso.mapping import activation_kernels, tracing_kernels
from ceiling_dso_ros.dso.start import initializer
from ceiling_dso_ros.dso.tracking import tracking_kernels
from ceiling_dso_ros.dso.window import candidates
from ceiling_dso_ros.dso.window.keyframe_window import KeyframeArrays
from ceiling_dso_ros.dso.window.pair_geometry import pair_geometry

USERS = {
    "HUBER": (pattern, activation_kernels, residual_kernels, tracing_kernels, tracking_kernels),
    "GRADIENT_WEIGHT": (pattern, activation_kernels, candidates, residual_kernels),
}
MEMBERS = ((linearization, "pair_geometry"), (initializer.Initializer, "_try_dual"))


@pytest.fixture
def change(monkeypatch):
    """Makes a change of the method until the test ends."""
    touched = [(module, name) for name, modules in USERS.items() for module in modules]
    for owner, name in (*touched, *MEMBERS):
        monkeypatch.setattr(owner, name, getattr(owner, name))
    return lambda title: CHANGES[title]()


@pytest.fixture
def moved_keyframes():
    """Two keyframes away from their evaluation points."""
    step = np.array([0.1, -0.2, 0.05, 0.02, 0.01, -0.03])
    T_eval = np.stack([np.eye(4), se3.exp(step)])
    T = np.stack([se3.exp(0.5 * step), se3.exp(3.0 * step)])
    affine = np.array([[0.1, 2.0], [-0.2, 1.0]])
    return KeyframeArrays(
        T_eval,
        np.zeros((2, 2)),
        np.zeros((2, 8)),
        T,
        affine,
        np.ones(2),
        np.zeros(2, np.float32),
        np.zeros(2, np.int64),
    )


def test_squares_instead_of_hubers_norm(change):
    change("no Huber norm")
    assert {module.HUBER for module in USERS["HUBER"] if module is not tracking_kernels} == {np.float32(1e6)}
    assert tracking_kernels.HUBER == 20.0  # where the energy of a saturated residual is the square of the cutoff


def test_one_weight_for_all_gradients(change):
    change("no gradient weight")
    for module in USERS["GRADIENT_WEIGHT"]:
        c2 = module.GRADIENT_WEIGHT
        assert np.sqrt(c2 / (c2 + np.float32(2 * 255.0**2))) == pytest.approx(1.0, abs=1e-6)


def test_jacobians_at_the_newest_estimate(change, moved_keyframes):
    intrinsics = np.array([200.0, 210.0, 151.0, 117.0])
    first = pair_geometry(moved_keyframes, 2, intrinsics)
    change("no first-estimate Jacobians")
    newest = linearization.pair_geometry(moved_keyframes, 2, intrinsics)
    T = moved_keyframes.T_camera_world[1] @ se3.inverse(moved_keyframes.T_camera_world[0])
    np.testing.assert_allclose(newest.R_eval[0, 1], T[:3, :3], atol=1e-6)
    np.testing.assert_allclose(newest.t_eval[0, 1], T[:3, 3], atol=1e-6)
    assert newest.gain_eval[0, 1] == pytest.approx(np.exp(-0.3))
    assert first.gain_eval[0, 1] == 1.0
    assert not np.allclose(first.t_eval[0, 1], newest.t_eval[0, 1], atol=1e-2)
    np.testing.assert_array_equal(first.KRKi[0, 1], newest.KRKi[0, 1])


def test_first_solution_of_a_plane(change):
    before = initializer.Initializer._try_dual
    change("initialiser: first solution of a plane")
    assert initializer.Initializer._try_dual is not before
    assert initializer.Initializer._try_dual(None, 0) is None
