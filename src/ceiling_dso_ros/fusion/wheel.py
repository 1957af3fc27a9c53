# SPDX-License-Identifier: BSD-3-Clause
"""Wheel odometry of a differential drive: samples of its wheels, or of its own odometry, to steps."""

import math
from typing import Callable, Optional, Tuple

import numpy as np
from numpy.typing import ArrayLike

from ceiling_dso_ros.dso.durations import seconds
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.config import RobotModel, WheelConfig
from ceiling_dso_ros.fusion.resolution import Resolution
from ceiling_dso_ros.fusion.wheel_motion import WheelMotion, WheelNoise, WheelStep

INT32_RANGE = 2**32
TURN = 2.0 * math.pi
JITTER_S = 0.05  # by which a busy computer stamps samples late, so that the next one seems to follow too soon
STILL_RAD = 0.1  # a wheel that has turned by less in a silence has stood
WRAPPED = 1.01 * TURN  # what angles that are wrapped at a turn do not exceed
# Finer readings are no better: gears have play, and wheels are not round. Nor may the covariance become singular.
FINEST_RAD, FINEST_M = 1e-3, 5e-5

FAR_M = 1.0  # from the origin of an odometry: nearer, it may have come back by itself

# Of ticks, radians or metres; beyond what an int64 holds, differences are no longer those of wheels.
LARGEST = 2.0**63

# Two readings and the seconds between them -> the (3,) twist, None when no robot can have moved so.
TwistOf = Callable[[np.ndarray, np.ndarray, float], Optional[np.ndarray]]


class WheelOdometry:
    """Dead reckoning from encoder samples, or from the robot's own odometry.

    Attributes:
        message: what was wrong with the last sample, in words; empty when nothing was.
        dropped: how many samples were not used.
    """

    def __init__(self, robot: RobotModel, config: WheelConfig) -> None:
        config.check()
        self._robot = robot
        self._config = config
        self._signs = np.where(robot.reversed_wheels, -1.0, 1.0)
        self._tick_m = TURN * max(robot.wheel_radius_m) / robot.ticks_per_turn
        self.noise = WheelNoise(config, robot.wheel_base_m, self._tick_m)
        self.reset()

    def reset(self) -> None:
        """Forget everything: the next sample is the origin."""
        self._angle_steps, self._forward_steps = Resolution(FINEST_RAD), Resolution(FINEST_M)
        self._range_rad = np.full((2, 2), np.nan)  # smallest and largest angle of each wheel
        self._total: Optional[WheelMotion] = None
        self.message = ""
        self.dropped = 0
        self._last: Optional[Tuple[int, np.ndarray]] = None
        self._rate = np.zeros(3)
        self._spare_s = 0.0  # of the last intervals, in which the wheels could have moved further than they did

    @property
    def heard(self) -> bool:
        """Whether there was a first sample, the origin of the motion."""
        return self._last is not None

    @property
    def total(self) -> WheelMotion:
        """The motion since the first sample.

        Raises:
            RuntimeError: there was none yet.
        """
        if self._total is None:
            raise RuntimeError("the wheels have not been heard yet")
        return self._total

    @property
    def covariance_odom(self) -> np.ndarray:
        """(3, 3) covariance of the total x, y, yaw in the frame of the origin, the mean radius's error included."""
        own = self.noise.covariance(self.total, self.noise.constants_covariance(with_radius=True))
        return planar.rotate_covariance(own, self.total.pose[2])

    def add_ticks(self, stamp_ns: int, left: int, right: int) -> Optional[WheelStep]:
        """Take in int32 counters, which may wrap around.

        Returns:
            The step since the last sample; None for the first sample and for one that is not used.
        """
        self.noise.resolution_m = self._tick_m
        # They are stamped when they arrive, and several may come at once.
        return self._add(stamp_ns, np.array([left, right], float), self._twist_of_ticks, self._config.silence_s)

    def add_angles(self, stamp_ns: int, left_rad: float, right_rad: float) -> Optional[WheelStep]:
        """Take in the angles of the wheels, endless or wrapped at a whole turn; returns as `add_ticks`.

        Their resolution is not that of the ticks, which the driver may have refined: it is found from the angles.
        """
        self.noise.resolution_m = self._angle_steps.step * max(self._robot.wheel_radius_m)
        return self._add(stamp_ns, np.array([left_rad, right_rad]), self._twist_of_angles)

    def add_pose(self, stamp_ns: int, pose: np.ndarray) -> Optional[WheelStep]:
        """Take in the (3,) pose of an odometry as it is; returns as `add_ticks`."""
        self.noise.resolution_m = 2.0 * self._forward_steps.step  # forward is the mean of two wheels
        return self._add(stamp_ns, np.asarray(pose, dtype=float), self._twist_of_poses)

    def _add(
        self, stamp_ns: int, reading: np.ndarray, twist_of: TwistOf, jitter_s: float = JITTER_S
    ) -> Optional[WheelStep]:
        self.message = ""
        if not (np.abs(reading) <= LARGEST).all():
            self._drop(f"wheels: sample with a value that is not finite at {_text(stamp_ns)} dropped")
            return None
        if self._last is None:
            self._last, self._total = (stamp_ns, reading), WheelMotion.nothing(stamp_ns)
            return None
        last_ns, last_reading = self._last
        if stamp_ns <= last_ns:
            self._drop(f"wheels: sample of {_text(stamp_ns)} dropped, it is not later than the last ({_text(last_ns)})")
            return None
        self._last = (stamp_ns, reading)
        dt = seconds(stamp_ns - last_ns)
        twist = twist_of(last_reading, reading, dt)
        known = twist is not None
        if twist is not None:
            self._rate = twist / max(dt, self._needed_s(twist))
            self._spare_s = min(max(self._spare_s + dt - self._needed_s(twist), 0.0), jitter_s)
        else:  # the best guess is that the robot kept its velocity for a short time
            twist, self._spare_s = self._rate * min(dt, self._config.silence_s), 0.0
            self.message = f"wheels: impossible motion before {_text(stamp_ns)}, counters restarted?"
        step = WheelStep(last_ns, stamp_ns, twist, known)
        self._total = self.noise.extend(self.total, step)
        return step

    def _needed_s(self, twist: np.ndarray) -> float:
        """Seconds for a motion at full speed of the faster wheel."""
        forward, left, turn = twist
        return (math.hypot(forward, left) + 0.5 * self._robot.wheel_base_m * abs(turn)) / self._config.max_speed_m_s

    def _is_possible(self, twist: np.ndarray, dt: float) -> bool:
        """Whether a robot can have moved so; over single intervals stamps that jitter would seem too fast."""
        return self._needed_s(twist) <= self._spare_s + dt

    def _drop(self, message: str) -> None:
        self.message = message
        self.dropped += 1

    def _twist_of_ticks(self, before: np.ndarray, after: np.ndarray, dt: float) -> Optional[np.ndarray]:
        if _begins_anew(before, after, self._robot.ticks_per_turn):
            return None
        ticks = (after - before + INT32_RANGE // 2) % INT32_RANGE - INT32_RANGE // 2
        return self._twist_of_turns(ticks * (TURN / self._robot.ticks_per_turn), dt)

    def _twist_of_angles(self, before: np.ndarray, after: np.ndarray, dt: float) -> Optional[np.ndarray]:
        if _begins_anew(before, after, TURN):
            return None
        turns = after - before
        both = np.array([*self._range_rad, before, after])
        self._range_rad = np.array([np.nanmin(both, axis=0), np.nanmax(both, axis=0)])
        # Angles that have stayed within a turn, of zero too, may be wrapped: any change may hide turns, as far as the
        # last rate tells, which it does not after a silence. Others count on, and what they cannot do is none of turns.
        wraps = (np.ptp(self._range_rad, axis=0) < WRAPPED) & (np.abs(self._range_rad).max(axis=0) < WRAPPED)
        if dt >= self._config.silence_s and (wraps & (np.abs(turns) > STILL_RAD)).any():
            return None
        may_wrap = wraps & (dt < self._config.silence_s)
        too_fast = wraps & (np.abs(turns) * self._robot.wheel_radius_m > self._config.max_speed_m_s * dt)
        expected = np.array([-0.5, 0.5]) * self._robot.wheel_base_m * self._rate[2] + self._rate[0]
        expected = np.where(dt < self._config.silence_s, expected * dt, 0.0) / self._robot.wheel_radius_m * self._signs
        turns += np.where(may_wrap | too_fast, TURN * np.round((expected - turns) / TURN), 0.0)
        twist = self._twist_of_turns(turns, dt)
        if twist is not None:
            self._angle_steps.add(turns, dt)
        return twist

    def _twist_of_turns(self, turns_rad: np.ndarray, dt: float) -> Optional[np.ndarray]:
        left, right = self._signs * turns_rad * self._robot.wheel_radius_m
        twist = np.array([0.5 * (left + right), 0.0, (right - left) / self._robot.wheel_base_m])
        return twist if self._is_possible(twist, dt) else None

    def _twist_of_poses(self, before: np.ndarray, after: np.ndarray, dt: float) -> Optional[np.ndarray]:
        if _begins_anew(np.hypot(*before[:2]), np.hypot(*after[:2]), FAR_M):
            return None
        twist = planar.logmap(planar.between(before, after))
        if not self._is_possible(twist, dt):
            return None
        self._forward_steps.add(twist[:1], dt)
        return twist


def _begins_anew(before: ArrayLike, after: ArrayLike, far: float) -> bool:
    """Whether readings far from zero are near it all at once, as when their driver was restarted.

    After a silence, nothing else tells that from a motion.
    """
    size = np.abs(before)
    return bool(np.all(size > far) and np.all(np.abs(after) < 0.1 * size))


def _text(stamp_ns: int) -> str:
    return f"{seconds(stamp_ns):.6f} s"
