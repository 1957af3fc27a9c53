# SPDX-License-Identifier: BSD-3-Clause
"""Measurements of the other sensors: wheel encoders, laser scanner, inertial unit."""

from typing import NamedTuple, Sequence, Tuple

import numpy as np
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.io.recording import RobotDescription
from ceiling_dso_ros.simulation.events import Event, of_kind
from ceiling_dso_ros.simulation.motion import STEP_S, Motion
from ceiling_dso_ros.simulation.robot import GRAVITY_M_S2, T_BASE_IMU, T_BASE_LASER, Robot, WheelErrors

INT32_RANGE = 2**32
SLIP = 0.5  # share of a slipping wheel's rotation that does not move the robot

SCAN_ANGLES = np.radians(np.linspace(-135.0, 135.0, 541))
SCAN_RANGE_M = (0.1, 30.0)
SCAN_NOISE_M = 0.01

GYRO_NOISE_RAD_S, GYRO_BIAS_RAD_S = 0.003, 0.002
ACCELERATION_NOISE_M_S2, ACCELERATION_BIAS_M_S2 = 0.03, 0.03
DIFFERENCE_S = 0.002


class Encoders(NamedTuple):
    """Wheel encoders over a whole drive.

    Attributes:
        time_s: (N,) times of the readings.
        ticks: (N, 2) int64 counters, left and right, that never wrap.
    """

    time_s: np.ndarray
    ticks: np.ndarray

    @property
    def counters(self) -> np.ndarray:
        """Values of 32-bit counters that wrap around, (N, 2) int64 in the range of int32."""
        return (self.ticks + INT32_RANGE // 2) % INT32_RANGE - INT32_RANGE // 2

    def angles_rad(self, ticks_per_turn: float) -> np.ndarray:
        """Angles turned since the first reading, (N, 2)."""
        return (self.ticks - self.ticks[0]) * (2 * np.pi / ticks_per_turn)


def read_encoders(
    motion: Motion,
    robot: RobotDescription,
    errors: WheelErrors,
    events: Sequence[Event],
    time_s: np.ndarray,
    rng: np.random.Generator,
) -> Encoders:
    """Readings of the wheels' encoders.

    Args:
        motion: of the base.
        robot: its real dimensions.
        errors: noise of wheels and readings.
        events: only slips are used; the left wheel slips.
        time_s: (N,) when they are read.
        rng: for the noise and the first counter values, which are shortly before the wrap-around.
    """
    yaw = motion.poses(time_s)[:, 2]
    turned = (yaw - yaw[0]) * robot.wheel_base_m / 2
    distance = motion.travel_m(time_s)[:, None] + turned[:, None] * (-1.0, 1.0)
    steps = np.abs(np.diff(distance, axis=0))
    noise = errors.travel_noise_m * np.sqrt(steps) * rng.standard_normal(steps.shape)
    distance[1:] += np.cumsum(noise, axis=0)
    distance[:, 0] += _slipped(motion, robot.wheel_base_m, events, time_s)
    turns = distance / (2 * np.pi * np.array(robot.wheel_radius_m))
    ticks = turns * robot.ticks_per_turn + errors.tick_noise * rng.standard_normal(turns.shape)
    first = rng.integers(2**31 - 60_000, 2**31 - 20_000, 2)
    return Encoders(time_s, np.floor(ticks).astype(np.int64) + first)


def _slipped(motion: Motion, wheel_base_m: float, events: Sequence[Event], time_s: np.ndarray) -> np.ndarray:
    """Distance that the left wheel has turned by slipping, (N,)."""
    fine = np.arange(0.0, motion.duration_s + STEP_S, STEP_S)
    speed, yaw_rate = motion.rates(fine).T
    wheel_speed = speed - yaw_rate * wheel_base_m / 2
    slipping = np.zeros(len(fine), dtype=bool)
    for event in of_kind(events, "slip"):
        slipping |= (fine >= event.start_s) & (fine < event.end_s)
    lost = np.cumsum(np.where(slipping, wheel_speed * SLIP / (1.0 - SLIP), 0.0)) * STEP_S
    return np.interp(time_s, fine, lost)


def scan(robot: Robot, floor_plan: np.ndarray, time_s: float, rng: np.random.Generator) -> np.ndarray:
    """Ranges of the laser scanner at SCAN_ANGLES, (541,) metres, inf where there is nothing within reach.

    Args:
        robot: where it is.
        floor_plan: (n, 2, 2) segments in x, y.
        time_s: when.
        rng: for the noise.
    """
    x, y, yaw = robot.motion.poses(np.array([time_s]))[0]
    c, s = np.cos(yaw), np.sin(yaw)
    origin = np.array([x, y]) + T_BASE_LASER[0, 3] * np.array([c, s])
    rays = np.stack([np.cos(SCAN_ANGLES + yaw), np.sin(SCAN_ANGLES + yaw)], axis=1)
    along = floor_plan[:, 1] - floor_plan[:, 0]
    toward = floor_plan[:, 0] - origin
    with np.errstate(divide="ignore", invalid="ignore"):
        # origin + r ray = start + q along, solved by cross products
        across = rays[:, None, 0] * along[None, :, 1] - rays[:, None, 1] * along[None, :, 0]
        r = (toward[:, 0] * along[:, 1] - toward[:, 1] * along[:, 0])[None] / across
        q = (toward[None, :, 0] * rays[:, None, 1] - toward[None, :, 1] * rays[:, None, 0]) / across
        hit = (r > 0) & (q >= 0) & (q <= 1)
    ranges = np.where(hit, r, np.inf).min(axis=1) + SCAN_NOISE_M * rng.standard_normal(len(rays))
    return np.where((ranges >= SCAN_RANGE_M[0]) & (ranges <= SCAN_RANGE_M[1]), ranges, np.inf)


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
