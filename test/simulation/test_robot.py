# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.simulation.driving.motion import DriveLimits, Motion, Wait, straight
from ceiling_dso_ros.simulation.events import Event
from ceiling_dso_ros.simulation.robot import NOMINAL, Robot, Vibration, WheelErrors


def robot(vibration=Vibration(), events=()):
    motion = Motion(np.array([1.0, -2.0, 0.6]), [Wait(2.0), straight(8.0)], DriveLimits())
    return Robot(
        motion, WheelErrors().applied(NOMINAL), vibration, events, Robot.random_tones(np.random.default_rng(0))
    )


def test_without_vibration_the_base_stays_on_the_floor():
    still = robot(Vibration(0.0, 0.0, 0.0))
    T = still.T_world_base(np.linspace(0.0, 10.0, 101))
    np.testing.assert_allclose(T[:, 2, :], np.tile([0, 0, 1, 0], (101, 1)), atol=1e-12)
    np.testing.assert_allclose(T[0, :2, 3], [1.0, -2.0], atol=1e-9)
    np.testing.assert_allclose(T[0, :2, 0], [np.cos(0.6), np.sin(0.6)], atol=1e-9)


def test_vibration_has_its_size_while_driving_and_none_while_standing():
    shaking = robot()
    T = shaking.T_world_base(np.linspace(5.0, 9.0, 4000))
    tilt = Rotation.from_matrix(T[:, :3, :3]).as_euler("ZYX", degrees=True)
    assert tilt[:, 1].std() == pytest.approx(0.08, rel=0.4)
    assert tilt[:, 2].std() == pytest.approx(0.06, rel=0.4)
    assert T[:, 2, 3].std() == pytest.approx(0.0004, rel=0.4)
    standing = shaking.T_world_base(np.linspace(0.0, 2.0, 100))
    np.testing.assert_allclose(standing, standing[:1].repeat(100, axis=0), atol=1e-9)


def test_a_bump_pitches_the_robot_and_dies_out():
    bumped = robot(Vibration(0.0, 0.0, 0.0), [Event("bump", 5.0, 0.6)])
    pitch = np.degrees(np.arcsin(-bumped.T_world_base(np.linspace(4.0, 8.0, 2001))[:, 2, 0]))
    assert np.abs(pitch[:500]).max() < 1e-9
    assert 0.5 < np.abs(pitch).max() < 1.3
    assert np.abs(pitch[-100:]).max() < 1e-3


def test_the_camera_looks_up_with_a_lever_arm_and_a_tilt_of_one_to_two_degrees():
    T = NOMINAL.T_base_camera
    tilt_deg = np.degrees(np.arccos(T[2, 2]))
    assert 1.0 < tilt_deg < 2.0
    assert np.linalg.norm(T[:2, 3]) > 0.1
    T_world_camera = robot().T_world_camera(np.array([5.0]))[0]
    np.testing.assert_allclose(T_world_camera, robot().T_world_base(np.array([5.0]))[0] @ T)


def test_wheel_errors_are_applied_as_named():
    true = WheelErrors(radius=0.02, ratio=0.01, wheel_base=-0.03).applied(NOMINAL)
    left, right = true.wheel_radius_m
    assert (left + right) / 2 == pytest.approx(0.098 * 1.02)
    assert right / left == pytest.approx(1.01, abs=1e-4)
    assert true.wheel_base_m == pytest.approx(0.485 * 0.97)


def test_mounts_follow_the_conventions_of_frames():
    mounts = robot().static_transforms()
    for T in mounts.values():
        np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
        assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)
    np.testing.assert_allclose(mounts["camera_front_optical_frame"][:3, 2], [1, 0, 0])  # looks ahead
    np.testing.assert_allclose(mounts["camera_front_optical_frame"][:3, 1], [0, 0, -1])  # image down is down
    right = np.linalg.inv(mounts["camera_up_optical_frame"]) @ mounts["camera_up_right_optical_frame"]
    np.testing.assert_allclose(right[:3, 3], [0.095, 0, 0], atol=1e-12)
