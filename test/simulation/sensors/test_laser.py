# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.obstacles import Obstacles, vehicle
from ceiling_dso_ros.simulation.rendering.structures import room_plan
from ceiling_dso_ros.simulation.sensors.laser import SWEEP_S, LaserModel, LaserScanner
from ceiling_dso_ros.simulation.simulation import Simulation

LASER_X_M = 0.28
SCAN_ANGLES = LaserModel().angles


class TurningOnTheSpot:
    """A base at the origin with a constant yaw rate."""

    def __init__(self, yaw_rate):
        self.yaw_rate = yaw_rate

    def poses(self, time_s):
        return np.stack([0 * time_s, 0 * time_s, self.yaw_rate * time_s], axis=1)


def scanner(floor_plan, movers=()):
    return LaserScanner(Obstacles(floor_plan, movers), np.random.default_rng(0))


def test_the_scan_measures_the_walls():
    motion = Simulation(SimulationConfig("square")).robot.motion
    ranges = scanner(room_plan(21.0, 15.0)).sweep(motion, 0.0)
    x, y, yaw = motion.poses(0.0)[0]
    x, y = x + LASER_X_M * np.cos(yaw), y + LASER_X_M * np.sin(yaw)
    heading = SCAN_ANGLES + yaw
    hits = np.stack([x + ranges * np.cos(heading), y + ranges * np.sin(heading)], axis=1)[np.isfinite(ranges)]
    distance_to_wall = np.minimum(np.abs(np.abs(hits[:, 0]) - 10.5), np.abs(np.abs(hits[:, 1]) - 7.5))
    assert 530 < len(hits) < len(ranges) == 541, "a few rays do not come back"
    assert 0.005 < distance_to_wall.mean() < distance_to_wall.max() < 0.06
    assert np.abs(hits[:, 0]).max() < 10.6 and np.abs(hits[:, 1]).max() < 7.6


def test_a_box_stands_in_the_way_of_the_scan_and_far_walls_are_out_of_reach():
    ranges = scanner(room_plan(100.0, 100.0, [[3.28, 0.0, 0.5, 0.5]])).sweep(TurningOnTheSpot(0.0), 0.0)
    assert ranges[270] == pytest.approx(2.5, abs=0.1)
    assert np.isinf(ranges[[0, 540]]).all()


def test_each_ray_is_cast_while_the_robot_turns():
    """A pillar straight ahead is met where the robot, which has turned half a sweep by then, sees it."""
    pillar = [5.0, 0.0, 0.15, 0.15]
    still, turning = (
        scanner(room_plan(100.0, 100.0, [pillar])).sweep(TurningOnTheSpot(rate), 0.0) for rate in (0.0, 1.0)
    )
    angles = [np.mean(SCAN_ANGLES[ranges < 10.0]) for ranges in (still, turning)]
    assert angles[0] == pytest.approx(0.0, abs=0.01)
    lever = LASER_X_M / (5.0 - LASER_X_M)  # the scanner itself moves sideways, too
    assert angles[1] == pytest.approx(-SWEEP_S / 2 * (1 + lever), abs=0.004)


def test_a_vehicle_is_where_it_has_driven():
    eyes = scanner(room_plan(100.0, 100.0), [vehicle((LASER_X_M + 4.4, -2.0), (LASER_X_M + 4.4, 2.0), speed_m_s=1.0)])
    before, beside, back = (eyes.sweep(TurningOnTheSpot(0.0), time_s - SWEEP_S / 2) for time_s in (0.5, 2.0, 6.0))
    assert np.isinf(before[270])
    assert beside[270] == pytest.approx(4.0, abs=0.05)
    assert back[270] == pytest.approx(4.0, abs=0.05)


def test_a_mirror_may_turn_clockwise_and_rays_and_noise_can_be_chosen():
    plan = room_plan(21.0, 15.0, [[3.0, 2.0, 0.5, 0.5]])
    exact = [
        LaserModel(rays=271, range_noise_m=0.0, lost_share=0.0, clockwise=clockwise) for clockwise in (False, True)
    ]
    left, right = (
        LaserScanner(Obstacles(plan), np.random.default_rng(0), model).sweep(TurningOnTheSpot(0.0), 0.0)
        for model in exact
    )
    np.testing.assert_allclose(left, right[::-1], atol=1e-9)
    assert exact[1].angles[0] > 0.0 > exact[0].angles[0]
    assert exact[0].time_increment_s == pytest.approx(exact[1].time_increment_s) == pytest.approx(SWEEP_S / 270)
    noisy = LaserModel(rays=1081, range_noise_m=0.05)
    ranges = LaserScanner(Obstacles(room_plan(21.0, 15.0)), np.random.default_rng(0), noisy).sweep(
        TurningOnTheSpot(0.0), 0.0
    )
    truth = LaserScanner(
        Obstacles(room_plan(21.0, 15.0)), np.random.default_rng(0), LaserModel(rays=1081, range_noise_m=0.0)
    ).sweep(TurningOnTheSpot(0.0), 0.0)
    both = np.isfinite(ranges) & np.isfinite(truth)
    assert np.std((ranges - truth)[both]) == pytest.approx(0.05, rel=0.1)
