# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.lidar import uncertainty
from ceiling_dso_ros.lidar.mapping.joint_solution import gauge_motions
from ceiling_dso_ros.lidar.scans.poses import compose


def test_the_covariance_is_that_of_the_errors_after_an_alignment():
    """Errors drawn from the information of a chain, with the truth moved anywhere: the aligned ones are as computed."""
    rng = np.random.default_rng(0)
    poses = np.column_stack([np.linspace(0.0, 6.0, 7), np.sin(np.arange(7.0)), np.zeros(7)])
    J = np.zeros((18, 21))
    for k in range(6):  # x, y, yaw from one to the next, in the frame of the map, with the lever of the turn
        d = poses[k + 1] - poses[k]
        J[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = -np.eye(3)
        J[3 * k : 3 * k + 3, 3 * k + 3 : 3 * k + 6] = np.eye(3)
        J[3 * k, 3 * k + 2], J[3 * k + 1, 3 * k + 2] = d[1], -d[0]
    sigmas = np.tile((0.01, 0.02, 0.003), 6)
    information = J.T @ np.diag(sigmas**-2.0) @ J
    np.testing.assert_allclose(information @ gauge_motions(poses), 0.0, atol=1e-6)
    computed = uncertainty.keyframe_covariances(information, poses)
    inverse = np.linalg.pinv(J)
    drawn = []
    for _ in range(4000):
        error = (inverse @ (sigmas * rng.standard_normal(18))).reshape(7, 3)
        drawn.append(uncertainty.aligned_errors(poses + error, compose(np.tile(rng.normal(size=3), (7, 1)), poses)))
    found = np.einsum("nki,nkj->kij", drawn, drawn) / len(drawn)
    np.testing.assert_allclose(np.einsum("kii->ki", found), np.einsum("kii->ki", computed), rtol=0.12)


def test_a_corridor_is_told_by_its_eigenvalues():
    informations = np.array([np.diag([1e2, 1e6, 1e5]), np.diag([5e5, 1e6, 1e5])])
    assert uncertainty.is_corridor(informations).tolist() == [True, False]
    coupled = np.array([[1e6, 0.0, 0.0], [0.0, 1e6, 1e6], [0.0, 1e6, 1.0001e6]])
    assert uncertainty.is_corridor(coupled[None])[0], "y and yaw cannot be told apart"


def test_a_scan_is_as_sure_as_its_map_and_its_own_points():
    own = np.array([np.diag([1.0, 2.0, 0.1]), np.diag([4.0, 4.0, 0.4])]) * 1e-6
    of_keyframe = np.array([np.diag([3.0, 3.0, 0.2])]) * 1e-6
    found = uncertainty.scan_covariances(of_keyframe, own[:1], np.zeros(2, int), own)
    np.testing.assert_allclose(found[0], of_keyframe[0], atol=1e-12)
    np.testing.assert_allclose(found[1], np.diag([6.0, 5.0, 0.5]) * 1e-6, atol=1e-12)


def test_matrices_become_positive():
    rng = np.random.default_rng(1)
    matrices = rng.normal(size=(20, 3, 3))
    found = uncertainty.positive(matrices + matrices.transpose(0, 2, 1))
    assert np.linalg.eigvalsh(found).min() > -1e-12
    good = matrices @ matrices.transpose(0, 2, 1)
    np.testing.assert_allclose(uncertainty.positive(good), good, atol=1e-9)


def test_a_robot_that_stands_is_aligned_by_its_yaw():
    truth = np.tile([1.0, 2.0, 0.5], (4, 1))
    poses = np.tile([0.0, 0.0, -1.0], (4, 1))
    np.testing.assert_allclose(uncertainty.aligned_errors(poses, truth), 0.0, atol=1e-12)


def test_normalised_errors_are_one_in_the_mean():
    rng = np.random.default_rng(2)
    root = np.array([[0.01, 0, 0], [0.005, 0.02, 0], [0.001, 0, 0.002]])
    errors = rng.standard_normal((5000, 3)) @ root.T
    nees = uncertainty.normalised_errors(errors, np.tile(root @ root.T, (5000, 1, 1)))
    assert nees.mean() == pytest.approx(1.0, abs=0.05)
