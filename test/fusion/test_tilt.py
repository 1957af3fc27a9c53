# SPDX-License-Identifier: BSD-3-Clause
"""The tilt against simulated robots whose tilt is known. All limits follow from the sigmas that it states."""

from dataclasses import replace

import numpy as np
import pytest
from fused_drive import fuse_drive
from scipy.spatial.transform import Rotation
from simulated_drive import Truth, mount, simulate_drive

from ceiling_dso_ros.fusion.config import VisualConfig
from ceiling_dso_ros.fusion.graph import Interval
from ceiling_dso_ros.fusion.tilt import MOUNT_SIGMA_RAD, SHAKING_RAD, UNEVENNESS_M, TiltFilter, upright_rotation
from ceiling_dso_ros.fusion.visual import VisualMotion

CONFIG = VisualConfig()
UNIT_M = 4.0
WINDOW = 20  # nodes of the graph
CAMERA = mount()


def pose(x, y, z, yaw, roll=0.0, pitch=0.0):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("ZYX", (yaw, pitch, roll)).as_matrix()
    T[:3, 3] = x, y, z
    return T


def circle(count, step_m=0.25, radius_m=2.0):
    """(N, 3) x, y, yaw."""
    angle = np.arange(count) * step_m / radius_m
    return np.column_stack([radius_m * np.sin(angle), radius_m * (1.0 - np.cos(angle)), angle])


def straight(count, step_m=0.25):
    return np.column_stack([np.arange(count) * step_m, np.zeros(count), np.zeros(count)])


class Robot:
    """A robot that drives over a floor, and what its odometry sees.

    Its camera is turned by a roll and a pitch against `CAMERA`, which is believed; it shakes, the floor is uneven, and
    the odometry errs at random, and in each step by the same turn about axes of the world (lean).
    """

    def __init__(self, poses, seed=0, mount_error=(0.0, 0.0), shaking=1e-3, floor=None, lean=(0.0, 0.0), noise=1.0):
        self.shaking = shaking
        rng = np.random.default_rng(seed)
        wrong = pose(0, 0, 0, 0, *mount_error)
        wrong[:3, :3] = wrong[:3, :3] @ CAMERA[:3, :3]
        wrong[:3, 3] = CAMERA[:3, 3]
        cameras = []
        for x, y, yaw in poses:
            base = pose(x, y, noise * UNEVENNESS_M * rng.normal(), yaw, *(shaking * rng.normal(size=2)))
            cameras.append((np.eye(4) if floor is None else floor) @ base @ wrong)
        plane = np.eye(3) if floor is None else floor[:3, :3]
        normals = [CAMERA[:3, :3] @ T[:3, :3].T @ plane[:, 2] for T in cameras]
        self.angles = np.array([[np.arctan2(n[1], n[2]), -np.arcsin(n[0])] for n in normals])  # roll, pitch
        self.intervals = [Interval(1, 0, None)]
        for number, (before, after) in enumerate(zip(cameras, cameras[1:]), 2):
            T = np.linalg.inv(before) @ after
            T[:3, 3] = T[:3, 3] / UNIT_M + noise * CONFIG.translation_sigma * rng.normal(size=3)
            turned = noise * CONFIG.yaw_sigma_rad * rng.normal(size=3) + after[:3, :3].T @ [*lean, 0.0]
            T[:3, :3] = T[:3, :3] @ Rotation.from_rotvec(turned).as_matrix()
            self.intervals.append(Interval(number, 0, None, VisualMotion.from_camera(T, CAMERA), True))

    def followed(self, to=None, unit_m=UNIT_M):
        """The filter, and the tilts of the last window."""
        tilts = TiltFilter(CONFIG)
        count = len(self.intervals) if to is None else to
        for newest in range(1, count + 1):
            window = self.intervals[max(0, newest - WINDOW) : newest]
            if newest < count:
                tilts.settle(window[0], unit_m)
        return tilts, tilts.smoothed(window, [unit_m] * len(window))

    def errors(self, tilts):
        """(N, 2) errors of tilts by node, and (N, 2) their sigmas."""
        nodes = sorted(tilts)
        found = np.array([tilts[node].angles for node in nodes])
        return found - self.angles[np.array(nodes) - 1], np.array([tilts[node].sigmas for node in nodes])


def test_the_upright_frame_has_the_normal_as_its_z():
    angles = np.array([0.02, -0.03])
    base = pose(0, 0, 0, 0, *angles)
    np.testing.assert_allclose(upright_rotation(angles), base[:3, :3], atol=1e-15)


def test_without_noise_the_tilt_is_exact_up_to_the_second_order():
    """From a first tilt that is known, a robot that rolls and pitches is followed by the camera alone."""
    robot = Robot(circle(40), mount_error=(0.006, -0.004), shaking=1e-5, noise=0.0)
    _, tilts = robot.followed()
    error, sigma = robot.errors(tilts)
    # The prior of the mount still pulls by its share of the information, and products of two tilts are left out.
    pull = (sigma / MOUNT_SIGMA_RAD) ** 2 * 0.006
    assert (np.abs(error) < pull + 0.006**2).all()


@pytest.mark.parametrize("mount_error", [(0.0, 0.0), (np.radians(1.0), 0.0), (0.0, np.radians(-1.0))])
def test_a_mount_that_is_wrong_by_a_degree_is_found_in_turns(mount_error):
    for seed in range(5):
        robot = Robot(circle(150), seed, mount_error)
        _, tilts = robot.followed()
        error, sigma = robot.errors(tilts)
        assert (sigma < 1e-3).all()  # a seventeenth of a degree
        assert (np.abs(error) < 4.5 * sigma).all()  # one of 150 000 is further away


def test_sigmas_are_as_large_as_the_errors_are():
    """Of 150 drives with mounts that are as wrong as is believed: the squares of errors have their variance as mean."""
    drives, squares = 150, []
    rng = np.random.default_rng(7)
    for seed in range(drives):
        robot = Robot(circle(60), seed, MOUNT_SIGMA_RAD * rng.normal(size=2), SHAKING_RAD)
        _, tilts = robot.followed()
        node = len(robot.intervals) - 7  # as old as one that leaves the odometry's window
        error, sigma = robot.errors({node: tilts[node]})
        squares.append(((error / sigma) ** 2).ravel())
    squares = np.array(squares)
    spread = 3.0 * np.sqrt(2.0 / drives)  # of the mean of so many squares of a standard normal variable
    np.testing.assert_allclose(squares.mean(axis=0), 1.0, atol=spread)


def test_what_later_keyframes_tell_is_used():
    robot = Robot(circle(60), 3, shaking=SHAKING_RAD)
    _, tilts = robot.followed()
    sigma = robot.errors(tilts)[1]
    assert (sigma[10] < 0.9 * sigma[-1]).all()


def test_the_roll_of_a_mount_is_not_known_from_a_straight_drive_but_its_pitch_is():
    robot = Robot(straight(60), 1, (np.radians(1.0), np.radians(1.0)))
    _, tilts = robot.followed()
    error, sigma = robot.errors(tilts)
    assert (sigma[:, 0] > 0.3 * MOUNT_SIGMA_RAD).all()
    assert (sigma[:, 1] < 1e-3).all()
    assert (np.abs(error[:, 1]) < 4.5 * sigma[:, 1]).all()


def test_a_floor_that_leans_changes_nothing():
    """What counts is the plane of the motion, whatever the odometry's world is."""
    upright = Robot(circle(50), 4, (0.01, 0.0)).followed()[1]
    leaning = Robot(circle(50), 4, (0.01, 0.0), floor=pose(3.0, -1.0, 0.5, 0.7, 0.1, -0.2)).followed()[1]
    for node in upright:
        np.testing.assert_allclose(upright[node].angles, leaning[node].angles, atol=1e-12)


def test_a_map_that_leans_more_and_more_does_not_carry_the_tilt_away():
    """The odometry turns by one sigma per keyframe, always to the same side of its world: by 30 mrad in the end.

    A filter that corrects by the share k of what it sees lags behind a steady error q by q / k at most, and here
    q = k shaking in a long drive: by as much as the robot shakes.
    """
    robot = Robot(circle(150), 5, lean=(0.0, CONFIG.yaw_sigma_rad))
    _, tilts = robot.followed()
    error, sigma = robot.errors(tilts)
    assert (np.abs(error) < robot.shaking + 4.5 * sigma).all()


@pytest.mark.parametrize("shaking", [5e-4, 1e-3, 4e-3, 8e-3])
def test_the_shaking_is_learned(shaking):
    """Twice or half of it is excluded by the squares of 300 rolls and pitches, which are known within 6 %."""
    tilts, _ = Robot(circle(300), 6, shaking=shaking).followed()
    assert tilts.shaking_rad == shaking


@pytest.mark.parametrize("path", [circle, straight])
def test_an_odometry_that_leans_by_a_milliradian_a_step_is_not_believed(path):
    """By five sigma in each step, always to the same side, as under a faint ceiling: by 100 mrad in the end."""
    robot = Robot(path(120), 11, lean=(1e-3, 5e-4))
    for newest in (30, 60, 120):
        error, sigma = robot.errors(robot.followed(newest)[1])
        # What is left is that a robot with a mount that is nearly right stands upright, up to its shaking.
        assert (sigma < np.hypot(MOUNT_SIGMA_RAD, 2.0 * robot.shaking)).all()
        assert (np.abs(error) < 4.5 * sigma).all()


def test_when_the_odometry_is_right_again_the_tilt_is_as_exact_as_before():
    good = Robot(circle(200), 12)
    bad = Robot(circle(80), 12, lean=(1e-3, 5e-4))
    for number in range(1, 80):
        good.intervals[number] = bad.intervals[number]
    error, sigma = good.errors(good.followed()[1])
    assert (sigma < 1e-3).all()
    assert (np.abs(error) < 4.5 * sigma).all()


def test_a_cable_on_the_floor_is_an_outlier():
    """One keyframe that pitches by a degree: its neighbours' tilts stay within their sigmas, and so does its own."""
    robot = Robot(circle(60), 8)
    bump = np.array([np.radians(1.0), 0.0])
    before, after = robot.intervals[50].visual, robot.intervals[51].visual
    turn = Rotation.from_euler("z", [-before.yaw]).as_matrix()[0, :2, :2]
    robot.intervals[50] = Interval(51, 0, None, _tilted(before, turn.T @ bump), True)
    robot.intervals[51] = Interval(52, 0, None, _tilted(after, -bump), True)
    robot.angles[50] += [0.0, bump[0]]
    _, tilts = robot.followed()
    error, sigma = robot.errors(tilts)
    assert (np.abs(error) < 4.5 * sigma).all()


def _tilted(visual, tilt):
    return VisualMotion(visual.shift, visual.climb, visual.yaw, visual.tilt + tilt, visual.lever_m)


def test_where_the_camera_was_blind_only_the_mount_is_known():
    robot = Robot(circle(60), 9, (0.01, 0.01))
    robot.intervals[-1] = Interval(len(robot.intervals), 0, None)
    tilts, of_node = robot.followed()
    last = of_node[len(robot.intervals)]
    assert (last.sigmas >= tilts.shaking_rad).all()
    error, sigma = robot.errors(of_node)
    assert (np.abs(error[-1]) < 4.5 * sigma[-1]).all()


def test_impossible_motions_leave_the_numbers_in_order():
    """What an odometry of random numbers may tell, up to 1e8 units."""
    rng = np.random.default_rng(0)
    for unit_m in 10.0 ** np.arange(-4, 5):
        robot = Robot(circle(60))
        for number, interval in enumerate(robot.intervals[1:], 1):
            size = 10.0 ** rng.uniform(-3.0, 8.0)
            tilt, yaw = rng.uniform(-CONFIG.tilt_limit_rad, CONFIG.tilt_limit_rad, 2), rng.uniform(-3.0, 3.0)
            lever_m = interval.visual.lever_m
            visual = VisualMotion(size * rng.normal(size=2), size * rng.normal(), yaw, tilt, lever_m)
            robot.intervals[number] = replace(interval, visual=visual)
        _, tilts = robot.followed(unit_m=unit_m)
        for tilt in tilts.values():
            assert np.isfinite(tilt.angles).all()
            assert (tilt.sigmas > 0.0).all()


@pytest.mark.parametrize("told", [True, False])
def test_keyframes_leave_the_fusion_with_their_tilt(told):
    """The whole fusion, with a mount that is told, and with one that is wrong by a degree."""
    drive = simulate_drive("loops", 40.0, seed=3, truth=Truth(T_base_camera=mount(roll_deg=2.5)))
    believed = drive.robot.T_base_camera if told else mount()
    drive.robot = replace(drive.robot, T_base_camera=believed)
    left = fuse_drive(drive, keep_history=False).estimator.take_left()
    normals = [believed[:3, :3] @ drive.cameras[keyframe.keyframe_id][:3, :3].T @ [0.0, 0.0, 1.0] for keyframe in left]
    error = np.array([keyframe.tilt.angles - [n[1], -n[0]] for keyframe, n in zip(left, normals)])
    sigma = np.array([keyframe.tilt.sigmas for keyframe in left])
    assert len(left) > 90
    assert (sigma < 1e-3).all()
    assert (np.abs(error) < 4.5 * sigma).all()
