# SPDX-License-Identifier: BSD-3-Clause
"""The mean wheel radius by a second camera: drives with exact poses of the camera, in two units of length."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.dso.status import KeyframeEstimate
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.calibration import MEAN_RADIUS, calibrate, with_radius
from ceiling_dso_ros.fusion.calibration_data import CameraPose
from ceiling_dso_ros.fusion.calibration_radius import radius_error
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
            told = {"log_scale": log_scale, "log_scale_sigma": SIGMA, "log_scale_common_sigma": COMMON}
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


def test_the_mean_over_segments_keeps_what_they_have_in_common():
    stamps = np.array([0, 10**9])
    scales = {k: SegmentScale(stamps, np.zeros(2), 0.003, 0.004) for k in (0, 1)}
    found = radius_error((0, 1), np.array([-0.02, -0.01]), np.diag([0.004, 0.004]) ** 2, scales)
    assert found.log_ratio == pytest.approx(0.015)
    assert found.sigma == pytest.approx(np.hypot(0.004, 0.005 / np.sqrt(2)))
