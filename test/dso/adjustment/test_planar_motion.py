# SPDX-License-Identifier: BSD-3-Clause
"""The constraint that a camera on a vehicle moves in a plane."""

import numpy as np
import pytest

from ceiling_dso_ros.dso.adjustment import planar_motion
from ceiling_dso_ros.dso.adjustment.planar_motion import add_planar_motion
from ceiling_dso_ros.dso.geometry import se3

FIRST, SIZE = 4, 8  # columns as in the bundle adjustment
NORMAL = np.array([0.02, -0.03, 1.0]) / np.linalg.norm([0.02, -0.03, 1.0])


def system(poses):
    columns = FIRST + SIZE * len(poses)
    H, b = np.zeros((columns, columns)), np.zeros(columns)
    add_planar_motion(NORMAL, np.array(poses), FIRST, SIZE, H, b)
    return H, b


def poses(spread, count=4):
    rng = np.random.default_rng(0)
    return [se3.exp(rng.normal(size=6) * spread) for _ in range(count)]


def turned(angle):
    return np.concatenate([np.zeros(3), angle * NORMAL])


def moved(T, step):
    return [se3.exp(step[FIRST + SIZE * k :][:6]) @ T[k] for k in range(len(T))]


def energy(T):
    """Half the sum of weighted squares, by its definition, with standard deviations that do not depend on the poses."""
    total = 0.0
    axes = np.linalg.svd(NORMAL[None])[2][1:]
    for i in range(len(T)):
        for j in range(i):
            T_ij = T[i] @ se3.inverse(T[j])
            tilt, height = axes @ T_ij[:3, :3] @ NORMAL, NORMAL @ T_ij[:3, 3]
            total += tilt @ tilt / planar_motion.TILT_RAD**2 + height**2 / planar_motion.HEIGHT**2
    return planar_motion.ENERGY / len(T) * total


def test_motions_in_the_plane_cost_nothing():
    along = np.cross(NORMAL, [1.0, 0.0, 0.0])
    plane = [se3.exp(turned(0.7 * k)) @ se3.exp(np.concatenate([0.2 * k * along, np.zeros(3)])) for k in range(4)]
    np.testing.assert_allclose(system(plane)[1], 0.0, atol=1e-6)


def test_gradient_and_hessian_are_those_of_the_energy():
    """Near the minimum, where the standard deviations are those of nearby keyframes."""
    T = poses(1e-5)
    H, b = system(T)
    assert np.array_equal(H[:FIRST], np.zeros_like(H[:FIRST]))
    np.testing.assert_allclose(H, H.T, atol=1e-9 * np.abs(H).max())
    step = 1e-6
    for column in range(FIRST, H.shape[0]):
        if (column - FIRST) % SIZE > 5:
            assert not H[column].any()
            assert b[column] == 0.0
            continue
        change = np.zeros(H.shape[0])
        change[column] = step
        slope = (energy(moved(T, change)) - energy(moved(T, -change))) / (2 * step)
        assert b[column] == pytest.approx(slope, rel=1e-3, abs=1e-3 * np.abs(b).max())
        bent = (system(moved(T, change))[1] - system(moved(T, -change))[1]) / (2 * step)
        np.testing.assert_allclose(H[:, column], bent, rtol=1e-2, atol=1e-3 * np.abs(H).max())


def test_one_step_brings_the_keyframes_into_a_plane():
    T = poses(np.array([0.3, 0.3, 0.02, 0.02, 0.02, 0.5]))
    H, b = system(T)
    step = -np.linalg.lstsq(H, b, rcond=None)[0]
    assert np.abs(system(moved(T, step))[1]).max() < 1e-3 * np.abs(b).max()


def test_a_mount_that_is_two_degrees_off_is_within_the_standard_deviations():
    """Else a camera that nobody has calibrated would bend the map."""
    along = np.cross(NORMAL, [1.0, 0.0, 0.0])
    off = se3.exp(np.array([0, 0, 0, planar_motion.NORMAL_RAD, 0, 0]))[:3, :3] @ NORMAL
    axes = np.linalg.svd(off[None])[2][1:]
    for angle, way in ((0.0, 1.0), (0.5, 0.2), (2.0, 0.1), (0.1, 2.0)):
        T = se3.exp(turned(angle)) @ se3.exp(np.concatenate([way * along, np.zeros(3)]))
        e = np.append(axes @ T[:3, :3] @ off, off @ T[:3, 3])
        assert (e**2 <= planar_motion.variances(T[:3, :3], way**2)).all()


def test_far_keyframes_bind_less_than_near_ones():
    tilted = np.array([0.0, 0.0, 0.0, 0.01, 0.0, 0.0])
    near, far = ([np.eye(4), se3.exp(tilted + np.array([x, 0.0, 0.0, 0.0, 0.0, 0.0]))] for x in (0.01, 2.0))
    assert np.abs(system(far)[1][FIRST + 3 : FIRST + 6]).max() < 0.1 * np.abs(system(near)[1][FIRST + 3 :][:3]).max()
