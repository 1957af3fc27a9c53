# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.fusion.config import WheelConfig
from ceiling_dso_ros.lidar.mount_check import check_mount
from ceiling_dso_ros.lidar.scans.poses import Path, compose, expmap
from ceiling_dso_ros.lidar.scans.wheel_motion import WheelMotions

STAMPS = np.arange(600, dtype=np.int64) * 100_000_000


def drive():
    """A differential drive that turns to both sides."""
    time_s = STAMPS * 1e-9
    twists = np.column_stack([np.full(600, 0.05), np.zeros(600), 0.05 * np.sin(time_s)])
    poses = [np.zeros(3)]
    for arc in expmap(twists[:-1]):
        poses.append(compose(poses[-1], arc))
    return np.array(poses)


def seen_with(error, poses):
    """Where the base seems to be, which is at `error` of the true one."""
    rng = np.random.default_rng(0)
    return compose(poses, np.tile(error, (len(poses), 1))) + 0.001 * rng.standard_normal(poses.shape) * (1, 1, 0.3)


def test_a_right_mount_is_not_doubted():
    found = check_mount(STAMPS, seen_with((0.0, 0.0, 0.0), drive()), None)
    assert found.describe() == ""
    assert abs(found.yaw_rad) < 4 * found.yaw_sigma_rad + 1e-3
    assert abs(found.x_m) < 4 * found.x_sigma_m + 1e-3


def test_yaw_and_place_are_told():
    found = check_mount(STAMPS, seen_with((0.12, 0.0, np.radians(4.0)), drive()), None)
    assert np.degrees(found.yaw_rad) == pytest.approx(4.0, abs=0.3)
    assert found.x_m == pytest.approx(0.12, abs=0.02)
    assert "yaw by +4" in found.describe()
    assert "x by +0.1" in found.describe()


def test_turns_against_those_of_the_wheels():
    poses = drive()
    wheels = WheelMotions(Path(STAMPS, poses), 0.5, WheelConfig(), np.ones(len(poses) - 1, bool))
    assert not check_mount(STAMPS, poses, wheels).is_mirrored
    mirrored = poses * (1.0, -1.0, -1.0)
    assert "upside down" in check_mount(STAMPS, mirrored, wheels).describe()


def test_a_robot_that_stands_says_nothing():
    assert check_mount(STAMPS, np.zeros((600, 3)), None) is None
