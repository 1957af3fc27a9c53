# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.simulation.ceilings import CEILINGS
from ceiling_dso_ros.simulation.driving.sequences import SEQUENCES, TOURS, plan

ROBOT_RADIUS_M = 0.5


@pytest.mark.parametrize("ceiling", CEILINGS)
@pytest.mark.parametrize("name", SEQUENCES)
def test_the_robot_hits_nothing(name, ceiling):
    obstacles = CEILINGS[ceiling](np.random.default_rng(0)).obstacles
    for seed in range(5):
        motion = plan(name, 0.0, np.random.default_rng(seed))
        times = np.arange(0.0, motion.duration_s, 0.1)
        assert obstacles.clearance_m(motion.poses(times)[:, :2], times).min() > ROBOT_RADIUS_M


@pytest.mark.parametrize("name", SEQUENCES)
def test_nobody_drives_faster_than_the_platform(name):
    motion = plan(name, 0.0, np.random.default_rng(0))
    speed, yaw_rate = np.abs(motion.rates(np.arange(0.0, motion.duration_s, 0.01))).max(axis=0)
    assert 0.85 < speed <= 1.401
    assert yaw_rate < 1.2
    assert 10.0 < motion.duration_s < 120.0


@pytest.mark.parametrize("name", SEQUENCES)
def test_a_wanted_duration_is_filled_with_laps(name):
    motion = plan(name, 300.0, np.random.default_rng(0))
    assert 300.0 <= motion.duration_s < 450.0
    speeds = motion.rates(np.arange(0.0, 300.0, 0.05))
    assert (np.abs(speeds).max(axis=1) > 0.01).mean() > 0.5


def test_every_seed_starts_a_little_elsewhere():
    starts = [plan("square", 0.0, np.random.default_rng(seed)).poses(0.0)[0] for seed in (0, 1, 0)]
    np.testing.assert_array_equal(starts[0], starts[2])
    assert 0.01 < np.linalg.norm(starts[0] - starts[1]) < 1.0


def test_loops_come_back_to_where_they_have_been():
    """Each of the small loops crosses its own way: the robot is within 0.1 m of an earlier place five times."""
    motion = plan("loops", 0.0, np.random.default_rng(0))
    time = np.arange(1.5, motion.duration_s - 2.0, 0.05)
    points = motion.poses(time)[:, :2]
    near = np.linalg.norm(points[:, None] - points[None], axis=-1) < 0.1
    later, _ = np.nonzero(near & (time[:, None] - time[None] > 3.0))
    crossings = 1 + np.count_nonzero(np.diff(np.unique(later)) > 5)
    assert crossings >= 5


@pytest.mark.parametrize("name", TOURS)
def test_tours_start_anywhere_in_a_free_hall_and_keep_off_all_that_moves(name):
    obstacles = CEILINGS["random"](np.random.default_rng(0)).obstacles
    starts = []
    for seed in range(6):
        motion = plan(name, 0.0, np.random.default_rng(seed))
        times = np.arange(0.0, motion.duration_s, 0.1)
        poses = motion.poses(times)
        assert obstacles.clearance_m(poses[:, :2], times).min() > ROBOT_RADIUS_M
        speed, yaw_rate = np.abs(motion.rates(times)).max(axis=0)
        assert 0.85 < speed <= 1.21
        assert yaw_rate < 1.0
        np.testing.assert_allclose(poses[-1, :2], poses[0, :2], atol=0.02)
        starts.append(poses[0])
    assert np.ptp(starts, axis=0).min() > 2.0
