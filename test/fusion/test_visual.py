# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.config import VisualConfig
from ceiling_dso_ros.fusion.visual import VisualMotion

SCALE = 4.2


def mount():
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("ZYX", [-88.0, -1.0, 1.5], degrees=True).as_matrix()
    T[:3, 3] = 0.18, 0.04, 0.62
    return T


def seen(motion, tilt=(0.0, 0.0), climb_m=0.0):
    """What a camera sees of a base that moves, and nods about x and y and climbs."""
    wobble = np.eye(4)
    wobble[:3, :3] = Rotation.from_rotvec([*tilt, 0.0]).as_matrix()
    wobble[2, 3] = climb_m
    T = np.linalg.inv(mount()) @ planar.lift(motion) @ wobble @ mount()
    T[:3, 3] /= SCALE
    return VisualMotion.from_camera(T, mount())


@pytest.mark.parametrize("motion", [(0.3, 0.0, 0.0), (0.0, 0.0, 0.4), (0.2, 0.05, -0.3)])
def test_a_tilted_camera_off_the_centre_tells_the_motion_of_the_base(motion):
    np.testing.assert_allclose(seen(motion).base_motion(SCALE), motion, atol=1e-12)
    assert seen(motion).on_floor(VisualConfig())


def test_a_nod_of_the_base_is_not_taken_for_a_motion():
    """Two milliradians at 0.62 m of height are 1.2 mm, more than the camera's noise."""
    motion = (0.15, 0.0, 0.05)
    nodding = seen(motion, tilt=(0.002, -0.002))
    np.testing.assert_allclose(nodding.base_motion(SCALE), motion, atol=1e-4)
    ignored = SCALE * nodding.shift - (planar.rotation(0.05) - np.eye(2)) @ [0.18, 0.04]
    assert np.abs(ignored - motion[:2]).max() > 1e-3


@pytest.mark.parametrize(
    ("motion", "possible"),
    [((0.3, 0.03, 0.2), True), ((0.3, 0.1, 0.2), False), ((0.0, 0.05, 0.0), False), ((-0.3, 0.03, -0.2), True)],
)
def test_wheels_hardly_move_sideways(motion, possible):
    assert seen(motion).on_floor(VisualConfig())
    assert seen(motion).on_wheels(SCALE, VisualConfig()) == possible


@pytest.mark.parametrize("wobble", [{"tilt": (0.05, 0.0)}, {"climb_m": 0.2}])
def test_tilting_or_climbing_is_no_motion_on_a_floor(wobble):
    assert not seen((0.15, 0.0, 0.05), **wobble).on_floor(VisualConfig())


def test_the_covariance_of_the_camera_is_that_of_the_motion_on_the_floor():
    """Against many cameras that err by so much in their own axes."""
    rng, motion = np.random.default_rng(2), (0.3, 0.05, 0.4)
    root = 1e-4 * rng.normal(size=(6, 6))
    covariance = root @ root.T
    T = np.linalg.inv(mount()) @ planar.lift(np.array(motion)) @ mount()
    T[:3, 3] /= SCALE
    found = []
    for error in rng.multivariate_normal(np.zeros(6), covariance, 4000):
        E = np.eye(4)
        E[:3, :3], E[:3, 3] = Rotation.from_rotvec(error[3:]).as_matrix(), error[:3]
        erring = VisualMotion.from_camera(T @ E, mount())
        found.append([*erring.shift, erring.yaw])
    told = VisualMotion.from_camera(T, mount(), covariance).covariance
    np.testing.assert_allclose(told, np.cov(np.transpose(found)), rtol=0.1, atol=0.05 * np.abs(told).max())


def test_what_the_images_say_comes_on_top_of_the_error_model():
    config, covariance = VisualConfig(), np.diag([1e-6, 2e-6, 3e-6, 4e-6, 5e-6, 6e-6])
    T = np.eye(4)
    without, with_it = VisualMotion.from_camera(T, mount()), VisualMotion.from_camera(T, mount(), covariance)
    np.testing.assert_allclose(with_it.noise(config) - without.noise(config), with_it.covariance, rtol=1e-9, atol=1e-15)
    assert np.diag(without.noise(config)) == pytest.approx(np.square([1.5e-4, 1.5e-4, 2e-4]))


def test_the_errors_of_both_images_are_in_a_motion_on_its_own():
    """By numeric derivatives: both poses are moved in their cameras' own axes."""
    rng = np.random.default_rng(3)
    T_base_camera = mount()
    before, after = (se3.exp(rng.normal(0.0, 0.02, 6) * (1, 1, 0.1, 0.1, 0.1, 8)) for _ in range(2))
    covariances = [np.diag(rng.uniform(1.0, 4.0, 6)) * 1e-8 for _ in range(2)]

    def planar_of(xi):
        moved = [T @ se3.exp(part) for T, part in zip((before, after), (xi[:6], xi[6:]))]
        motion = VisualMotion.from_camera(se3.inverse(moved[0]) @ moved[1], T_base_camera)
        return np.array([*motion.shift, motion.yaw])

    steps = 1e-6 * np.eye(12)
    J = np.array([(planar_of(step) - planar_of(-step)) / 2e-6 for step in steps]).T
    expected = J @ np.block([[covariances[0], np.zeros((6, 6))], [np.zeros((6, 6)), covariances[1]]]) @ J.T
    start = VisualMotion.from_camera(np.eye(4), T_base_camera, covariances[0])
    motion = VisualMotion.from_camera(se3.inverse(before) @ after, T_base_camera, covariances[1])
    np.testing.assert_allclose(motion.with_start(start).covariance, expected, rtol=0.02, atol=1e-11)
