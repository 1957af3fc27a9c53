# SPDX-License-Identifier: BSD-3-Clause
"""The inertial unit."""

from typing import Tuple

import numpy as np
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.simulation.robot import GRAVITY_M_S2, T_BASE_IMU, Robot

GYRO_NOISE_RAD_S, GYRO_BIAS_RAD_S = 0.003, 0.002
ACCELERATION_NOISE_M_S2, ACCELERATION_BIAS_M_S2 = 0.03, 0.03
DIFFERENCE_S = 0.002


class InertialUnit:
    """Gyroscope and accelerometer on the base, with constant biases and white noise."""

    def __init__(self, robot: Robot, rng: np.random.Generator) -> None:
        self._robot = robot
        self._rng = rng
        self.gyro_bias = rng.normal(0.0, GYRO_BIAS_RAD_S, 3)
        self.acceleration_bias = rng.normal(0.0, ACCELERATION_BIAS_M_S2, 3)

    def measure(self, time_s: float) -> Tuple[np.ndarray, np.ndarray]:
        """Angular rate (rad/s) and specific force (m/s^2, +9.81 in z at rest) in the unit's own frame, (3,) each."""
        T = self._robot.T_world_base(time_s + np.array([-DIFFERENCE_S, 0.0, DIFFERENCE_S])) @ T_BASE_IMU
        R, p = T[:, :3, :3], T[:, :3, 3]
        rate = Rotation.from_matrix(R[0].T @ R[2]).as_rotvec() / (2 * DIFFERENCE_S)
        acceleration = (p[0] - 2 * p[1] + p[2]) / DIFFERENCE_S**2
        force = R[1].T @ (acceleration + GRAVITY_M_S2 * np.array([0.0, 0.0, 1.0]))
        return (
            rate + self.gyro_bias + GYRO_NOISE_RAD_S * self._rng.standard_normal(3),
            force + self.acceleration_bias + ACCELERATION_NOISE_M_S2 * self._rng.standard_normal(3),
        )
