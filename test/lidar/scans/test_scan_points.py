# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.experiments.scanned_drive import ScannedDrive
from ceiling_dso_ros.io.laser_scans import LaserScans
from ceiling_dso_ros.lidar.scans.poses import transformed
from ceiling_dso_ros.lidar.scans.scan_points import ScanPoints, steady
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.obstacles import Obstacles
from ceiling_dso_ros.simulation.rendering.structures import room_plan
from ceiling_dso_ros.simulation.sensors.laser import LaserModel

ROOM = Obstacles(room_plan(21.0, 15.0))


def distances_from_walls(points):
    x, y = np.abs(points).T
    return np.minimum(np.abs(x - 10.5), np.abs(y - 7.5))


@pytest.mark.parametrize("clockwise", [False, True])
def test_walls_are_straight_while_the_robot_turns(clockwise):
    laser = LaserModel(rays=1081, range_noise_m=0.0, lost_share=0.0, clockwise=clockwise)
    drive = ScannedDrive(SimulationConfig("spin", duration_s=6.0, laser=laser), ROOM)
    scans, points = drive.scans, ScanPoints(drive.scans)
    motion = drive.recording.simulation.robot.motion
    turning = int(np.argmax(np.abs(np.diff(drive.truth[:, 2]))))
    time_s = (scans.stamps_ns[turning] - scans.stamps_ns[0]) / 1e9 + 0.05
    speed, yaw_rate = motion.rates(np.array([time_s + 0.0375]))[0]
    assert abs(yaw_rate) > 0.5
    pose = drive.truth[turning]
    right = transformed(points.of(turning, steady(np.array([speed, 0.0, yaw_rate]))), pose)
    assert distances_from_walls(right).max() < 0.01
    assert distances_from_walls(transformed(points.of(turning, np.zeros((2, 3))), pose)).max() > 0.1


def test_a_laser_may_hang_upside_down_and_rays_without_a_return_are_left_out():
    ranges = np.array([[1.0, np.nan, 3.0]], np.float32)
    geometry = np.array([[0.0, np.pi / 2, 0.0]])
    hanging = np.diag([1.0, -1.0, -1.0, 1.0])
    hanging[:3, 3] = 0.5, 0.25, 0.2
    scans = LaserScans(np.array([0]), ranges, geometry, hanging)
    np.testing.assert_allclose(ScanPoints(scans).of(0, np.zeros((2, 3))), [[1.5, 0.25], [-2.5, 0.25]], atol=1e-6)
    standing = LaserScans(np.array([0]), ranges, np.array([[0.0, np.pi / 4, 0.0]]), hanging)
    np.testing.assert_allclose(ScanPoints(standing).of(0, np.zeros((2, 3))), [[1.5, 0.25], [0.5, -2.75]], atol=1e-6)


def test_rays_count_with_the_motion_since_the_stamp():
    """Ahead at 1 m/s: a ray that is cast 0.5 s after the first starts half a metre ahead."""
    scans = LaserScans(np.array([0]), np.ones((1, 3), np.float32), np.array([[0.0, 0.0, 0.5]]), np.eye(4))
    np.testing.assert_allclose(
        ScanPoints(scans).of(0, steady(np.array([1.0, 0.0, 0.0]))), [[1.0, 0.0], [1.5, 0.0], [2.0, 0.0]], atol=1e-12
    )


def test_a_change_of_the_motion_counts():
    """From rest with 2 m/s^2: after 0.5 s a quarter of a metre, after 1 s one metre."""
    scans = LaserScans(np.array([0]), np.ones((1, 3), np.float32), np.array([[0.0, 0.0, 0.5]]), np.eye(4))
    starts = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    np.testing.assert_allclose(ScanPoints(scans).of(0, starts), [[1.0, 0.0], [1.25, 0.0], [2.0, 0.0]], atol=1e-12)


def test_points_are_put_between_those_of_one_surface_only():
    """A wall 4 m ahead, seen by rays 2 degrees apart, and another one 1 m behind it from the fifth ray on."""
    angles = np.radians(2.0) * np.arange(8)
    ranges = np.where(np.arange(8) < 4, 4.0, 5.0) / np.cos(angles)
    ranges[6] = np.nan
    scans = LaserScans(
        np.array([0]), ranges[None].astype(np.float32), np.array([[0.0, np.radians(2.0), 0.0]]), np.eye(4)
    )
    dense = ScanPoints(scans).dense(0, np.zeros((2, 3)))
    np.testing.assert_allclose(dense[:7], ScanPoints(scans).of(0, np.zeros((2, 3))))
    between = dense[7:]
    assert len(between) > 5
    np.testing.assert_allclose(np.minimum(np.abs(between[:, 0] - 4.0), np.abs(between[:, 0] - 5.0)), 0.0, atol=1e-6)
