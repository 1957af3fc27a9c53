# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.fusion import planar


@pytest.fixture(params=range(20))
def rng(request):
    return np.random.default_rng(request.param)


def test_wrap_keeps_half_a_turn_positive():
    assert planar.wrap(3 * np.pi) == pytest.approx(np.pi)
    assert planar.wrap(-3.5 * np.pi) == pytest.approx(0.5 * np.pi)
    assert planar.wrap(0.3) == pytest.approx(0.3)


def test_compose_is_the_product_of_matrices(rng):
    a, b = rng.normal(size=3), rng.normal(size=3)
    np.testing.assert_allclose(planar.lift(planar.compose(a, b)), planar.lift(a) @ planar.lift(b), atol=1e-12)


def test_between_undoes_compose(rng):
    a, b = rng.normal(size=3), rng.normal(size=3)
    np.testing.assert_allclose(planar.between(a, planar.compose(a, b)), b, atol=1e-12)
    np.testing.assert_allclose(planar.compose(a, planar.inverse(a)), 0.0, atol=1e-12)


def test_expmap_is_the_limit_of_many_small_steps(rng):
    twist = rng.normal(size=3)
    pose = np.zeros(3)
    for _ in range(4096):
        pose = planar.compose(pose, twist / 4096)
    np.testing.assert_allclose(planar.expmap(twist), pose, atol=2e-3)


def test_logmap_undoes_expmap(rng):
    for twist in (rng.normal(size=3), 1e-8 * rng.normal(size=3)):
        np.testing.assert_allclose(planar.logmap(planar.expmap(twist)), twist, atol=1e-12)


def test_adjoint_moves_an_increment_to_the_other_side(rng):
    pose, small = rng.normal(size=3), 1e-6 * rng.normal(size=3)
    moved = planar.compose(planar.adjoint(pose) @ small, pose)
    np.testing.assert_allclose(moved, planar.compose(pose, small), atol=1e-10)


@pytest.mark.parametrize("turn_scale", [1.0, 1e-7])
def test_right_jacobian_is_the_derivative_of_expmap(rng, turn_scale):
    twist = rng.normal(size=3) * [1.0, 1.0, turn_scale]
    columns = [
        planar.between(planar.expmap(twist - step), planar.expmap(twist + step)) / 2e-6 for step in 1e-6 * np.eye(3)
    ]
    np.testing.assert_allclose(planar.right_jacobian(twist), np.stack(columns, axis=1), atol=1e-5)


def test_rotate_covariance_turns_the_long_axis():
    own = np.diag([4.0, 1.0, 0.1])
    turned = planar.rotate_covariance(own, np.pi / 2)
    np.testing.assert_allclose(turned, np.diag([1.0, 4.0, 0.1]), atol=1e-12)


@pytest.mark.parametrize("size", [2, 3])
def test_inverses_of_small_matrices(rng, size):
    matrix = rng.normal(size=(size, size))
    inverse = {2: planar.inverse_2x2, 3: planar.inverse_3x3}[size](matrix)
    np.testing.assert_allclose(inverse @ matrix, np.eye(size), atol=1e-9)
