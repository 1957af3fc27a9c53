# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.simulation.driving.commanded import (
    COMMAND_TIMEOUT_S,
    LIMITS,
    ROBOT_RADIUS_M,
    STEP_S,
    CommandedMotion,
)
from ceiling_dso_ros.simulation.events import Event
from ceiling_dso_ros.simulation.obstacles import Obstacles
from ceiling_dso_ros.simulation.rendering.structures import room_plan
from ceiling_dso_ros.simulation.robot import NOMINAL, WheelErrors

TRUE = WheelErrors(ratio=0.02, wheel_base=0.03).applied(NOMINAL)


def base(true=NOMINAL, events=(), start=(0.0, 0.0, 0.0), room_m=100.0):
    return CommandedMotion(np.array(start), NOMINAL, true, events, Obstacles(room_plan(room_m, room_m)))


def drive(motion, seconds, speed, yaw_rate=0.0):
    """Command the same velocity again and again; returns speeds and yaw rates at each step."""
    rates = []
    for _ in range(round(seconds / STEP_S)):
        motion.command(speed, yaw_rate)
        motion.step()
        rates.append(motion.rates(np.array([motion.now_s]))[0])
    return np.array(rates)


def where(motion):
    return motion.poses(np.array([motion.now_s]))[0]


def test_it_reaches_what_is_commanded_within_its_limits():
    motion = base()
    rates = drive(motion, 3.0, 0.5, 0.4)
    np.testing.assert_allclose(rates[-1], [0.5, 0.4])
    accelerations = np.abs(np.diff(rates, axis=0)).max(axis=0) / STEP_S
    np.testing.assert_allclose(accelerations, [LIMITS.acceleration_m_s2, LIMITS.yaw_acceleration_rad_s2])
    rates = drive(base(), 4.0, 9.0, -9.0)
    np.testing.assert_allclose(rates[-1], [1.4, -LIMITS.yaw_rate_rad_s])


def test_a_constant_velocity_is_a_circle():
    motion = base()
    drive(motion, 3.0, 0.5, 0.5)
    points = []
    for _ in range(8):
        drive(motion, 1.7, 0.5, 0.5)
        points.append(where(motion)[:2])
    points = np.array(points)
    system = np.column_stack([2 * points, np.ones(8)])
    x, y, c = np.linalg.lstsq(system, (points**2).sum(axis=1), rcond=None)[0]
    assert np.sqrt(c + x * x + y * y) == pytest.approx(1.0, abs=1e-4)


def test_without_commands_it_stops():
    motion = base()
    drive(motion, 2.0, 0.8)
    start_s, speeds = motion.now_s, []
    for _ in range(200):
        motion.step()
        speeds.append(motion.rates(np.array([motion.now_s]))[0, 0])
    speeds = np.array(speeds)
    since = STEP_S * (1 + np.arange(200))
    np.testing.assert_allclose(speeds[since < COMMAND_TIMEOUT_S - 2 * STEP_S], 0.8)
    braking_s = 0.8 / LIMITS.acceleration_m_s2
    assert (speeds[since > COMMAND_TIMEOUT_S + braking_s] == 0.0).all()
    assert motion.now_s == pytest.approx(start_s + 2.0)


def test_the_controller_knows_only_the_nominal_robot():
    motion = base(TRUE)
    drive(motion, 5.0, 0.6)
    rolled, slipped = (ways[0] for ways in motion.wheel_ways_m(np.array([motion.now_s])))
    assert not slipped.any()
    np.testing.assert_allclose(rolled[1] / rolled[0], 1.02, atol=1e-3)
    assert where(motion)[2] == pytest.approx((rolled[1] - rolled[0]) / TRUE.wheel_base_m)
    np.testing.assert_allclose(rolled / TRUE.wheel_radius_m, rolled[::-1] / TRUE.wheel_radius_m[::-1])


def test_a_slipping_wheel_turns_as_commanded_and_the_base_falls_behind():
    dry, slipping = base(), base(events=[Event("slip", 2.0, 0.5)])
    for motion in (dry, slipping):
        drive(motion, 4.0, 0.6)
    turned = [np.sum(motion.wheel_ways_m(np.array([motion.now_s])), axis=0)[0] for motion in (dry, slipping)]
    np.testing.assert_allclose(turned[0], turned[1])
    _, slipped = slipping.wheel_ways_m(np.array([slipping.now_s]))
    np.testing.assert_allclose(slipped[0], [0.6 * 0.5 * 0.5, 0.0], atol=1e-3)
    yaw = slipped[0, 0] / NOMINAL.wheel_base_m
    assert where(slipping)[2] == pytest.approx(yaw, abs=1e-3)
    assert where(dry)[2] == pytest.approx(0.0, abs=1e-9)


def test_at_a_wall_the_wheels_turn_and_the_base_stands():
    motion = base(start=(3.0, 0.0, 0.0), room_m=10.0)
    drive(motion, 6.0, 0.6)
    assert where(motion)[0] == pytest.approx(5.0 - ROBOT_RADIUS_M, abs=0.01)
    _, slipped = (ways[0] for ways in motion.wheel_ways_m(np.array([motion.now_s])))
    assert (slipped > 1.0).all()
    assert (motion.rates(np.array([motion.now_s])) == 0.0).all()
    drive(motion, 4.0, -0.6)
    assert where(motion)[0] < 4.0, "away from it is free"


def test_poses_between_steps_follow_the_rates():
    motion = base(TRUE)
    drive(motion, 1.5, 1.0, 0.7)
    fine = np.arange(1.0, 1.4, 1e-4)
    poses, rates = motion.poses(fine), motion.rates(fine)
    velocity = np.gradient(poses, fine, axis=0)
    np.testing.assert_allclose(np.hypot(velocity[:, 0], velocity[:, 1])[1:-1], rates[1:-1, 0], atol=1e-3)
    np.testing.assert_allclose(velocity[1:-1, 2], rates[1:-1, 1], atol=2e-3)


@pytest.mark.long
def test_only_the_near_past_is_kept():
    motion = base()
    drive(motion, 60.0, 0.2)
    assert len(motion._states) <= 400
    fine = np.arange(motion.now_s - 1.5, motion.now_s, 1e-3)
    np.testing.assert_allclose(motion.poses(fine)[:, 0], where(motion)[0] - 0.2 * (motion.now_s - fine), atol=1e-9)
