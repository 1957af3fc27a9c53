# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.robot import T_BASE_IMU, Vibration
from ceiling_dso_ros.simulation.sensors.inertial import InertialUnit
from ceiling_dso_ros.simulation.simulation import Simulation


def simulation(sequence="square", **settings):
    return Simulation(SimulationConfig(sequence, **settings))


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
