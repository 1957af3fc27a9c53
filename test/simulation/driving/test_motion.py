# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.simulation.driving.motion import (
    DriveLimits,
    Motion,
    Turn,
    Wait,
    closed_curve,
    rounded_square,
    straight,
    transforms,
)

LIMITS = DriveLimits()
ORIGIN = np.zeros(3)
LEGS = {
    "square": [rounded_square(4.0, 2.0, 1)],
    "curve": [closed_curve(lambda t: (3 * np.sin(t) + np.sin(4 * t), 2 * np.cos(t) - np.cos(4 * t)), 1)],
    "there and back": [straight(5.0), straight(5.0, backward=True)],
    "turns": [Turn(2.0), Wait(0.3), Turn(-2.0)],
}


def times(motion):
    return np.arange(0.0, motion.duration_s, 0.002)


@pytest.mark.parametrize("name", LEGS)
def test_the_drive_keeps_its_limits(name):
    motion = Motion(ORIGIN, LEGS[name], LIMITS)
    rates = motion.rates(times(motion))
    accelerations = np.gradient(rates, 0.002, axis=0)
    assert np.abs(rates[:, 0]).max() <= 1.001 * LIMITS.speed_m_s
    assert np.abs(rates[:, 1]).max() <= 1.05 * LIMITS.yaw_rate_rad_s
    assert np.abs(accelerations[:, 0]).max() <= 1.01 * LIMITS.acceleration_m_s2
    assert np.abs(accelerations[:, 1]).max() <= 1.01 * LIMITS.yaw_acceleration_rad_s2
    assert np.abs(rates[[0, -1]]).max() < 1e-6, "starts and ends at rest"


@pytest.mark.parametrize("name", LEGS)
def test_wheels_cannot_go_sideways(name):
    motion = Motion(ORIGIN, LEGS[name], LIMITS)
    poses = motion.poses(times(motion))
    step, yaw = np.diff(poses[:, :2], axis=0), (poses[1:, 2] + poses[:-1, 2]) / 2
    forward = np.cos(yaw) * step[:, 0] + np.sin(yaw) * step[:, 1]
    sideways = np.cos(yaw) * step[:, 1] - np.sin(yaw) * step[:, 0]
    assert np.abs(sideways).sum() < 1e-4
    np.testing.assert_allclose(np.cumsum(forward), motion.travel_m(times(motion))[1:], atol=1e-4)


@pytest.mark.parametrize("name", LEGS)
def test_legs_that_close_end_where_they_began(name):
    motion = Motion(np.array([1.0, 2.0, 0.5]), LEGS[name], LIMITS)
    first, last = motion.poses(np.array([0.0, motion.duration_s]))
    np.testing.assert_allclose(last[:2], first[:2], atol=1e-6)
    assert (last[2] - first[2]) / (2 * np.pi) == pytest.approx(round((last[2] - first[2]) / (2 * np.pi)), abs=1e-6)


def test_laps_repeat_the_curve():
    one, three = (Motion(ORIGIN, [rounded_square(3.0, 2.0, laps)], LIMITS) for laps in (1, 3))
    assert three.travel_m(three.duration_s)[0] == pytest.approx(3 * one.travel_m(one.duration_s)[0])
    assert three.poses(three.duration_s)[0, 2] == pytest.approx(6 * np.pi)


def test_a_square_has_its_sides():
    poses = rounded_square(4.0, 2.0, 1).poses
    assert np.ptp(poses[:, 0]) == pytest.approx(np.ptp(poses[:, 1]), abs=1e-6)
    assert 4.0 < np.ptp(poses[:, 0]) < 4.0 + 2 * 2.0


def test_outside_its_time_the_robot_stands():
    motion = Motion(ORIGIN, [straight(3.0)], LIMITS)
    early, late = motion.poses(np.array([-5.0, motion.duration_s + 5.0]))
    np.testing.assert_allclose(early, ORIGIN, atol=1e-9)
    np.testing.assert_allclose(late, [3.0, 0.0, 0.0], atol=1e-9)


def test_transforms_turn_about_yaw_then_pitch_then_roll():
    T = transforms(np.array([[1.0, 2.0, 0.7]]), np.array([0.1]), np.array([0.02]), np.array([-0.03]))[0]
    np.testing.assert_allclose(T[:3, :3], Rotation.from_euler("ZYX", [0.7, 0.02, -0.03]).as_matrix(), atol=1e-12)
    np.testing.assert_allclose(T[:3, 3], [1.0, 2.0, 0.1])
    np.testing.assert_allclose(T[3], [0, 0, 0, 1])
