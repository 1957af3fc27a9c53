# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.dso.durations import nanoseconds
from ceiling_dso_ros.fusion.config import RobotModel, WheelConfig
from ceiling_dso_ros.fusion.wheel import WheelOdometry
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.robot import NOMINAL, WheelErrors
from ceiling_dso_ros.simulation.sensors.encoders import read_encoders
from ceiling_dso_ros.simulation.simulation import Simulation


def simulation(sequence="square", **settings):
    return Simulation(SimulationConfig(sequence, **settings))


def dead_reckoning(sim, robot):
    """Poses (N, 3) in the frame of the start, integrated from the wrapped counters with a robot's dimensions."""
    model = RobotModel(robot.T_base_camera, robot.wheel_base_m, robot.wheel_radius_m, robot.ticks_per_turn)
    odometry = WheelOdometry(model, WheelConfig())
    poses = []
    for time_s, (left, right) in zip(sim.encoders.time_s, sim.encoders.counters):
        odometry.add_ticks(nanoseconds(time_s), int(left), int(right))
        poses.append(odometry.total.pose)
    return np.array(poses)


def errors_m(sim, poses):
    """Distance of each position from the truth, both starting at the same pose."""
    truth = sim.robot.motion.poses(sim.encoders.time_s)
    x, y, yaw = truth[0]
    c, s = np.cos(yaw), np.sin(yaw)
    moved = np.stack([x + c * poses[:, 0] - s * poses[:, 1], y + s * poses[:, 0] + c * poses[:, 1]], axis=1)
    return np.linalg.norm(moved - truth[:, :2], axis=1)


@pytest.mark.parametrize("sequence", ["square", "loops", "spin", "stop_and_go", "straight"])
def test_the_true_robot_reckons_its_way_to_a_centimetre(sequence):
    sim = simulation(sequence)
    assert errors_m(sim, dead_reckoning(sim, sim.robot.true)).max() < 0.01


def test_the_nominal_robot_drifts():
    sim = simulation("square", wheels=WheelErrors(ratio=0.01, wheel_base=0.01))
    final = errors_m(sim, dead_reckoning(sim, sim.nominal))[-1]
    assert 0.3 < final < 8.0


def test_an_error_of_the_radius_is_an_error_of_scale():
    sim = simulation("straight", wheels=WheelErrors(radius=0.02, ratio=0.0, wheel_base=0.0))
    poses = dead_reckoning(sim, sim.nominal)
    assert 13.0 / poses[-1, 0] == pytest.approx(1.02, rel=1e-3)


def test_counters_wrap_around_within_32_bits():
    counters = simulation().encoders.counters
    assert counters.max() <= 2**31 - 1 and counters.min() >= -(2**31)
    assert (np.abs(np.diff(counters, axis=0)) > 2**31).any(axis=0).all(), "both wheels wrap on the way"


def test_travel_noise_is_a_random_walk_of_each_wheel():
    sim = simulation("straight")
    errors, time_s = WheelErrors(travel_noise_m=0.01, tick_noise=0.0), np.array([0.5, 13.5])
    ends = []
    for seed in range(400):
        rng = np.random.default_rng(seed)
        readings = read_encoders(sim.robot.motion, NOMINAL, errors, [], time_s, rng)
        ends.append(readings.angles_rad(NOMINAL.ticks_per_turn)[-1] * 0.098)
    np.testing.assert_allclose(np.mean(ends, axis=0), 13.0, atol=0.01)
    np.testing.assert_allclose(np.std(ends, axis=0), 0.01 * np.sqrt(13.0), rtol=0.15)
    assert abs(np.corrcoef(np.array(ends).T)[0, 1]) < 0.15


def test_a_slipping_wheel_turns_twice_as_far():
    dry, slipping = simulation("straight"), simulation("straight", events=("slip@6+0.5",))
    extra = (
        (slipping.encoders.ticks - dry.encoders.ticks)[-1] * 2 * np.pi / 4096 * np.array(dry.robot.true.wheel_radius_m)
    )
    driven = np.diff(dry.robot.motion.travel_m(np.array([6.0, 6.5])))[0]
    assert extra[0] == pytest.approx(driven, rel=0.02)
    assert extra[1] == pytest.approx(0.0, abs=1e-3)
    np.testing.assert_array_equal(
        slipping.robot.motion.poses(np.arange(14.0)),
        dry.robot.motion.poses(np.arange(14.0)),
        "the robot moves as planned",
    )
