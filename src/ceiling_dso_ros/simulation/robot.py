# SPDX-License-Identifier: BSD-3-Clause
"""The robot: the poses of its base and cameras at any time, and the rotation of its wheels.

base_link lies on the floor between the wheels, x ahead, y left, z up (REP-103). Optical frames: z along the
view, x right, y down.
"""

from dataclasses import dataclass, field
from typing import Dict, Sequence, Tuple

import numpy as np
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.io.recording import RobotDescription
from ceiling_dso_ros.simulation.driving.motion import BaseMotion, transforms
from ceiling_dso_ros.simulation.events import Event, of_kind

GRAVITY_M_S2 = 9.81


def pose(xyz: Sequence[float], rotation: Rotation) -> np.ndarray:
    """(4, 4) of a position and a rotation."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation.as_matrix(), xyz
    return T


def upward_camera(roll_deg: float = 1.3, pitch_deg: float = -0.9, yaw_deg: float = -89.2) -> np.ndarray:
    """T_base_camera of a camera on a mast that looks up, a little tilted and off the turning centre."""
    return pose((0.18, 0.04, 0.62), Rotation.from_euler("ZYX", (yaw_deg, pitch_deg, roll_deg), degrees=True))


NOMINAL = RobotDescription(4096.0, (0.098, 0.098), 0.485, upward_camera())
T_BASE_FORWARD = pose((0.31, 0.0, 0.42), Rotation.from_matrix([[0, 0, 1], [-1, 0, 0], [0, -1, 0]]))
T_BASE_LASER = pose((0.28, 0.0, 0.21), Rotation.identity())
T_BASE_IMU = pose((0.05, 0.0, 0.15), Rotation.identity())
STEREO_BASELINE_M = 0.095
UP, UP_RIGHT = "camera_up_optical_frame", "camera_up_right_optical_frame"


@dataclass(frozen=True)
class WheelErrors:
    """Differences between the real and the nominal wheels, and the noise of their readings.

    Attributes:
        radius: relative error of the mean radius.
        ratio: relative error of right radius / left radius.
        wheel_base: relative error of the wheel base.
        travel_noise_m: random walk of each wheel's distance, metres after one metre.
        tick_noise: white noise of each reading, ticks.
        turn_slip: share of its way by which each wheel turns further while the robot turns with 1 rad/s, as on a floor.
    """

    radius: float = 0.0
    ratio: float = 0.01
    wheel_base: float = 0.01
    travel_noise_m: float = 5e-5
    tick_noise: float = 0.3
    turn_slip: float = 0.0

    def applied(self, nominal: RobotDescription) -> RobotDescription:
        """The real robot."""
        left, right = nominal.wheel_radius_m
        gain = 1.0 + self.radius
        return RobotDescription(
            nominal.ticks_per_turn,
            (left * gain * (1.0 - self.ratio / 2), right * gain * (1.0 + self.ratio / 2)),
            nominal.wheel_base_m * (1.0 + self.wheel_base),
            nominal.T_base_camera,
        )


@dataclass(frozen=True)
class Vibration:
    """Shaking while driving: sums of sines whose amplitudes grow with the speed, and the bounce after a bump.

    Attributes:
        pitch_deg, roll_deg: root mean square at 1 m/s.
        height_m: the same of the height.
    """

    pitch_deg: float = 0.08
    roll_deg: float = 0.06
    height_m: float = 0.0004

    @property
    def sigmas(self) -> np.ndarray:
        """Height (m), pitch and roll (rad), (3,)."""
        return np.array([self.height_m, np.radians(self.pitch_deg), np.radians(self.roll_deg)])


TONES = 6
BUMP_PITCH_RAD, BUMP_HEIGHT_M, BUMP_HZ = np.radians(1.2), 0.006, 5.0


@dataclass(frozen=True)
class Robot:
    """A robot that drives.

    Attributes:
        motion: of its base over the floor.
        true: its real dimensions.
        vibration: how it shakes.
        events: bumps count here.
        tones: frequencies (Hz) and phases (rad) of the shaking, (2, 3, TONES).
    """

    motion: BaseMotion
    true: RobotDescription
    vibration: Vibration
    events: Sequence[Event]
    tones: np.ndarray = field(repr=False)

    @staticmethod
    def random_tones(rng: np.random.Generator) -> np.ndarray:
        """Tones between 3 and 17 Hz."""
        return np.stack([rng.uniform(3.0, 17.0, (3, TONES)), rng.uniform(0.0, 2 * np.pi, (3, TONES))])

    def T_world_base(self, time_s: np.ndarray) -> np.ndarray:
        """Poses of base_link, (N, 4, 4) of (N,) times."""
        height, pitch, roll = self._shaking(np.atleast_1d(time_s))
        return transforms(self.motion.poses(time_s), height, pitch, roll)

    def T_world_camera(self, time_s: np.ndarray) -> np.ndarray:
        """Poses of the upward camera's optical frame, (N, 4, 4) of (N,) times."""
        return self.T_world_base(time_s) @ self.true.T_base_camera

    def _shaking(self, time_s: np.ndarray) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
        frequencies, phases = self.tones
        angle = 2 * np.pi * frequencies[..., None] * time_s + phases[..., None]
        shape = np.sin(angle).sum(axis=1) * np.sqrt(2.0 / TONES)
        speed, yaw_rate = self.motion.rates(time_s).T
        effort = np.minimum(np.hypot(speed, 0.25 * yaw_rate), 1.5)
        height, pitch, roll = self.vibration.sigmas[:, None] * shape * effort
        for event in of_kind(self.events, "bump"):
            since = np.maximum(time_s - event.start_s, 0.0)
            bounce = np.exp(-4.0 * since / event.duration_s) * np.sin(2 * np.pi * BUMP_HZ * since)
            pitch, height = pitch + BUMP_PITCH_RAD * bounce, height + BUMP_HEIGHT_M * bounce
        return height, pitch, roll

    def static_transforms(self) -> Dict[str, np.ndarray]:
        """Child frame -> T_base_child of everything that is mounted on the base."""
        stereo = self.true.T_base_camera @ pose((STEREO_BASELINE_M, 0.0, 0.0), Rotation.identity())
        return {
            UP: self.true.T_base_camera,
            UP_RIGHT: stereo,
            "camera_front_optical_frame": T_BASE_FORWARD,
            "laser": T_BASE_LASER,
            "imu": T_BASE_IMU,
        }
