# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.fusion.config import RobotModel, WheelConfig
from ceiling_dso_ros.fusion.durations import nanoseconds
from ceiling_dso_ros.fusion.wheel import WheelOdometry
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.robot import NOMINAL, T_BASE_IMU, Vibration, WheelErrors
from ceiling_dso_ros.simulation.sensors import SCAN_ANGLES, InertialUnit, read_encoders, scan
from ceiling_dso_ros.simulation.simulation import Simulation
from ceiling_dso_ros.simulation.structures import room_plan


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


def test_the_scan_measures_the_walls():
    sim = simulation()
    ranges = scan(sim.robot, room_plan(21.0, 15.0), 0.0, np.random.default_rng(0))
    x, y, yaw = sim.robot.motion.poses(0.0)[0]
    x, y = x + 0.28 * np.cos(yaw), y + 0.28 * np.sin(yaw)
    heading = SCAN_ANGLES + yaw
    hits = np.stack([x + ranges * np.cos(heading), y + ranges * np.sin(heading)], axis=1)
    distance_to_wall = np.minimum(np.abs(np.abs(hits[:, 0]) - 10.5), np.abs(np.abs(hits[:, 1]) - 7.5))
    assert len(ranges) == 541
    assert distance_to_wall.max() < 0.06
    assert np.abs(hits[:, 0]).max() < 10.6 and np.abs(hits[:, 1]).max() < 7.6


def test_a_box_stands_in_the_way_of_the_scan_and_far_walls_are_out_of_reach():
    sim = simulation()
    x, y, yaw = sim.robot.motion.poses(0.0)[0]
    ahead = [x + 3.28 * np.cos(yaw), y + 3.28 * np.sin(yaw), 0.5, 0.5]
    ranges = scan(sim.robot, room_plan(100.0, 100.0, [ahead]), 0.0, np.random.default_rng(0))
    assert ranges[270] == pytest.approx(2.5, abs=0.1)
    assert np.isinf(ranges[[0, 540]]).all()


def test_the_inertial_unit_feels_gravity_and_the_motion():
    sim = simulation("loops", vibration=Vibration(0.0, 0.0, 0.0))
    unit = InertialUnit(sim.robot, np.random.default_rng(1))
    at_rest = np.array([np.concatenate(unit.measure(0.1 + 0.002 * k)) for k in range(400)])
    np.testing.assert_allclose(at_rest.mean(axis=0)[:3], unit.gyro_bias, atol=1e-3)
    np.testing.assert_allclose(at_rest.mean(axis=0)[3:] - unit.acceleration_bias, [0, 0, 9.81], atol=0.01)

    time = 20.0 + 0.005 * np.arange(400)
    moving = np.array([np.concatenate(unit.measure(t)) for t in time])
    speed, yaw_rate = sim.robot.motion.rates(time).T
    np.testing.assert_allclose((moving[:, 2] - unit.gyro_bias[2] - yaw_rate).mean(), 0.0, atol=2e-3)
    centripetal = (speed * yaw_rate).mean() + T_BASE_IMU[0, 3] * np.gradient(yaw_rate, 0.005).mean()
    assert (moving[:, 4] - unit.acceleration_bias[1]).mean() == pytest.approx(centripetal, abs=0.02)


def test_imu_rates_integrate_to_the_rotation_of_the_base():
    sim = simulation("loops")
    unit = InertialUnit(sim.robot, np.random.default_rng(1))
    time = np.arange(10.0, 14.0, 0.002)
    turned = Rotation.identity()
    for t in time:
        turned = turned * Rotation.from_rotvec(0.002 * (unit.measure(t)[0] - unit.gyro_bias))
    T = sim.robot.T_world_base(np.array([10.0 - 0.001, 14.0 - 0.001]))
    expected = Rotation.from_matrix(T[0, :3, :3].T @ T[1, :3, :3])
    assert np.degrees((turned.inv() * expected).magnitude()) < 0.2
