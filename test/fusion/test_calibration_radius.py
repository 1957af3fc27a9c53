# SPDX-License-Identifier: BSD-3-Clause
"""The mean wheel radius by a second camera: drives with exact poses of the camera, in two units of length."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.dso.status import KeyframeEstimate, ScaleMeasurement
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.calibration import MEAN_RADIUS, calibrate, with_radius
from ceiling_dso_ros.fusion.calibration_data import CameraPose, ImagePair
from ceiling_dso_ros.fusion.calibration_radius import SLIP_SIGMA, radius_error
from ceiling_dso_ros.fusion.config import RobotModel
from ceiling_dso_ros.fusion.metric_scale import SegmentScale, segment_scales
from ceiling_dso_ros.fusion.wheel_motion import WheelStep

STEP_S, COUNT = 0.05, 800
UNITS = (4.0, 2.5)  # metres per unit of the segments
RADIUS = 1.02  # true over nominal
SIGMA, COMMON = 0.002, 0.003


def mount():
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("ZYX", [-88.0, -1.0, 1.5], degrees=True).as_matrix()
    T[:3, 3] = 0.18, 0.04, 0.62
    return T


def a_drive(seed, error=0.0):
    """Steps of wheels that are larger than their nominal radius, poses, and the scales with a common error."""
    rng = np.random.default_rng(seed)
    base, T_base_camera = np.zeros(3), mount()
    steps, poses, keyframes = [], [], []
    begin_ns = 10**9
    for k in range(COUNT):
        twist = np.array([0.05, 0.0, 0.03 * np.sin(0.02 * k) + 0.02 * np.sin(0.11 * k)])
        seen = twist / RADIUS  # both wheels by the nominal radius; so is the turn
        seen[:2] += 1e-4 * rng.normal(size=2) * [1.0, 0.0]
        start_ns = begin_ns + round(k * STEP_S * 1e9)
        steps.append(WheelStep(start_ns, start_ns + round(STEP_S * 1e9), seen))
        base = planar.compose(base, planar.expmap(twist))
        segment = int(k > COUNT // 2)
        T = planar.lift(base) @ T_base_camera
        T[:3, 3] = T[:3, 3] / UNITS[segment] + 2e-5 * rng.normal(size=3)
        poses.append(CameraPose(steps[-1].end_ns, segment, T))
        if k % 10 == 0:
            log_scale = np.log(UNITS[segment]) + error + SIGMA * rng.normal()
            told = {"scale": ScaleMeasurement(log_scale, SIGMA, COMMON)}
            keyframes.append(KeyframeEstimate(k, steps[-1].end_ns, segment, T, (0.0, 0.0), False, **told))
    return steps, poses, segment_scales(keyframes)


def robot():
    T = mount()
    return RobotModel(T, 0.5, (0.098, 0.098))


def radius_of(calibration):
    return next(value for value in calibration.values if value.name == MEAN_RADIUS)


@pytest.mark.parametrize("error", [0.0, 0.003])
def test_the_radius_is_found_within_its_standard_deviation(error):
    steps, poses, scales = a_drive(0, error)
    calibration = calibrate(steps, poses, robot(), scales)
    found = radius_of(calibration)
    assert found.excited
    assert found.nominal == pytest.approx(0.098)
    assert found.value == pytest.approx(0.098 * RADIUS * np.exp(error), rel=1e-3)
    assert found.sigma / found.value == pytest.approx(COMMON, rel=0.1)
    left, right = calibration.robot.wheel_radius_m
    assert np.sqrt(left * right) == pytest.approx(found.value)
    # the wheels turn as the camera says, with the radius that was found: so the base was wrong by as much
    assert calibration.robot.wheel_base_m == pytest.approx(0.5 * np.exp(error), rel=2e-3)
    assert len(calibration.values) == 9


def test_without_scales_nothing_is_said_of_the_radius():
    steps, poses, scales = a_drive(0)
    plain = calibrate(steps, poses, robot())
    assert MEAN_RADIUS not in {value.name for value in plain.values}
    assert np.sqrt(np.prod(plain.robot.wheel_radius_m)) == pytest.approx(0.098)
    both = calibrate(steps, poses, robot(), scales)
    assert with_radius(plain.values, both.values[-1]) == both.values
    unsure = replace(both.values[-1], excited=False)
    assert with_radius(plain.values, unsure) == (*plain.values, unsure)
    assert with_radius(plain.values, None) == plain.values


def ways(rng, count=120, log_ratio=0.004, slip=0.012, turning=True):
    """Pairs of images of a drive with turns, on which wheels slip."""
    rates = rng.uniform(0.0, 0.9, count) if turning else np.zeros(count)
    cameras = rng.uniform(0.3, 0.5, count)
    wheels = np.exp(-log_ratio) * cameras * (1.0 + slip * rates) + 5e-4 * rng.normal(size=count)
    pairs = [ImagePair(k * 10**9, k * 10**9 + 4 * 10**8, 0, np.eye(3), np.zeros(3)) for k in range(count)]
    return pairs, np.column_stack([wheels, cameras]), 0.4 * rates * rng.choice([-1.0, 1.0], count)


def scale_of_cameras(sigma=0.0, common=0.0):
    return {0: SegmentScale(np.array([0, 10**9]), np.zeros(2), sigma, common)}


@pytest.mark.parametrize("turning", [True, False])
def test_slip_in_turns_is_no_error_of_the_radius(turning):
    found = [
        radius_error(*ways(np.random.default_rng(seed), turning=turning), scale_of_cameras()) for seed in range(200)
    ]
    errors = np.array([each.log_ratio for each in found]) - 0.004
    sigmas = np.array([each.sigma for each in found])
    assert np.mean((errors / sigmas) ** 2) == pytest.approx(1.0, abs=0.35)
    assert abs(errors.mean()) < 1e-4


def test_where_all_is_turning_the_slip_is_not_known():
    pairs, forward, turns = ways(np.random.default_rng(0))
    turns = np.full_like(turns, 0.4 * 0.8)
    assert radius_error(pairs, forward, turns, scale_of_cameras()).sigma == pytest.approx(0.8 * SLIP_SIGMA, rel=0.05)


def test_wrong_pairs_do_little_harm():
    pairs, forward, turns = ways(np.random.default_rng(0))
    before = radius_error(pairs, forward, turns, scale_of_cameras())
    forward[::20, 0] *= 1.3
    after = radius_error(pairs, forward, turns, scale_of_cameras())
    assert abs(after.log_ratio - before.log_ratio) < 3.0 * before.sigma


def test_errors_of_the_cameras_remain():
    arguments = ways(np.random.default_rng(0))
    exact = radius_error(*arguments, scale_of_cameras())
    found = radius_error(*arguments, scale_of_cameras(0.003, 0.004))
    assert found.log_ratio == exact.log_ratio
    assert found.sigma == pytest.approx(np.sqrt(exact.sigma**2 + 0.003**2 + 0.004**2))
