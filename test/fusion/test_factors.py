# SPDX-License-Identifier: BSD-3-Clause
import gtsam
import numpy as np
import pytest

from ceiling_dso_ros.fusion import factors, planar
from ceiling_dso_ros.fusion.visual import VisualMotion
from ceiling_dso_ros.fusion.wheel_motion import WheelMotion

FIRST, SECOND, SCALE = KEYS = (factors.pose_key(3), factors.pose_key(4), factors.scale_key(4))
SIZES = {FIRST: 3, SECOND: 3, SCALE: 1, factors.WHEEL_KEY: 2, factors.CAMERA_YAW_KEY: 1}
UNIT = gtsam.noiseModel.Unit.Create(3)


def random_visual(rng):
    return VisualMotion(rng.normal(size=2), 0.01, rng.normal(), 0.01 * rng.normal(size=2), np.array([0.18, 0.04, 0.62]))


def random_wheels(rng):
    return WheelMotion(0, 1_000_000_000, rng.normal(size=3), np.eye(3), 0.5 * rng.normal(size=(3, 3)))


def random_values(rng, calibration_sigma=0.1):
    values = gtsam.Values()
    values.insert(FIRST, gtsam.Pose2(*rng.normal(size=3)))
    values.insert(SECOND, gtsam.Pose2(*rng.normal(size=3)))
    values.insert(SCALE, float(rng.normal()))
    values.insert_vector(factors.WHEEL_KEY, calibration_sigma * rng.normal(size=2))
    values.insert(factors.CAMERA_YAW_KEY, 0.2 * float(rng.normal()))
    return values


def perturbed(values, key, axis, step):
    delta = gtsam.VectorValues()
    for other, size in SIZES.items():
        delta.insert(other, step * np.eye(size)[axis] if other == key else np.zeros(size))
    return values.retract(delta)


def numeric_jacobian(factor, values, key, step=1e-6):
    columns = [
        (
            factor.unwhitenedError(perturbed(values, key, axis, step))
            - factor.unwhitenedError(perturbed(values, key, axis, -step))
        )
        / (2.0 * step)
        for axis in range(SIZES[key])
    ]
    return np.stack(columns, axis=1)


def check_jacobians(factor, values):
    linear = factor.linearize(values)
    analytic = np.array(linear.getA())  # a copy: what getA returns does not outlive its factor
    numeric = np.hstack([numeric_jacobian(factor, values, key) for key in list(factor.keys())])
    np.testing.assert_allclose(analytic, numeric, atol=1e-7)


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("camera_yaw", [False, True])
def test_visual_factor_has_the_jacobians_of_its_error(seed, camera_yaw):
    rng = np.random.default_rng(seed)
    check_jacobians(factors.visual_factor(KEYS, random_visual(rng), UNIT, camera_yaw), random_values(rng))


@pytest.mark.parametrize("seed", range(10))
def test_calibrated_wheel_factor_has_the_jacobians_of_its_error(seed):
    rng = np.random.default_rng(seed)
    check_jacobians(factors.calibrated_wheel_factor((FIRST, SECOND), random_wheels(rng), UNIT), random_values(rng))


def test_wheel_factors_agree_when_the_calibration_is_nominal():
    rng = np.random.default_rng(1)
    wheels, values = random_wheels(rng), random_values(rng, calibration_sigma=0.0)
    plain = factors.wheel_factor((FIRST, SECOND), wheels, UNIT).unwhitenedError(values)
    calibrated = factors.calibrated_wheel_factor((FIRST, SECOND), wheels, UNIT).unwhitenedError(values)
    np.testing.assert_allclose(calibrated, plain, atol=1e-12)


def test_visual_factor_vanishes_for_the_motion_that_a_tilted_offset_camera_sees():
    lever = np.array([0.18, 0.04, 0.62])
    mount = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.02, -0.03, -1.5), lever)
    first, second = gtsam.Pose2(1.0, 2.0, 0.3), gtsam.Pose2(1.4, 2.1, 0.7)
    scale = 4.2
    wobble = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.002, -0.003, 0.0), np.zeros(3))
    base = gtsam.Pose3(first.between(second)).compose(wobble)
    camera = mount.inverse().compose(base).compose(mount).matrix()
    camera[:3, 3] /= scale
    visual = VisualMotion.from_camera(camera, mount.matrix())
    values = gtsam.Values()
    values.insert(FIRST, first)
    values.insert(SECOND, second)
    values.insert(SCALE, float(np.log(scale)))
    factor = factors.visual_factor(KEYS, visual, UNIT, camera_yaw=False)
    np.testing.assert_allclose(factor.unwhitenedError(values), 0.0, atol=1e-5)
    np.testing.assert_allclose(visual.tilt, [-0.003, -0.002], atol=2e-3)
    np.testing.assert_allclose(visual.base_motion(scale), planar.between([1.0, 2.0, 0.3], [1.4, 2.1, 0.7]), atol=1e-4)
