# SPDX-License-Identifier: BSD-3-Clause
"""The wheels' encoders."""

from typing import NamedTuple, Optional, Sequence

import numpy as np

from ceiling_dso_ros.io.recording import RobotDescription
from ceiling_dso_ros.simulation.driving.motion import STEP_S, Motion
from ceiling_dso_ros.simulation.events import Event, slip_share
from ceiling_dso_ros.simulation.robot import WheelErrors

WHEEL_HZ = 50.0  # readings per second
INT32_RANGE = 2**32


class Encoders(NamedTuple):
    """Readings of the wheel encoders.

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

    def angles_rad(self, ticks_per_turn: float, first_ticks: Optional[np.ndarray] = None) -> np.ndarray:
        """Angles turned since first_ticks (2,), by default the first reading, (N, 2)."""
        first = self.ticks[0] if first_ticks is None else first_ticks
        return (self.ticks - first) * (2 * np.pi / ticks_per_turn)


class EncoderPair:
    """Encoders that are read as often as wanted; what they have counted goes on.

    Args:
        robot: its real dimensions.
        errors: noise of wheels and readings.
        rng: for the noise and the first counter values, which are shortly before the wrap-around.
    """

    def __init__(self, robot: RobotDescription, errors: WheelErrors, rng: np.random.Generator) -> None:
        self._robot, self._errors, self._rng = robot, errors, rng
        self._last_s = 0.0
        self._last_m: Optional[np.ndarray] = None
        self._wandered_m, self._scrubbed_m = np.zeros(2), np.zeros(2)
        self._offset = np.zeros(2, dtype=np.int64)

    def read(self, time_s: np.ndarray, driven_m: np.ndarray, slipped_m: np.ndarray) -> Encoders:
        """The next readings.

        Args:
            time_s: (N,) when they are read.
            driven_m: (N, 2) signed way that each wheel has rolled over the floor.
            slipped_m: (N, 2) signed way that each has turned further by slipping.
        """
        is_first = self._last_m is None
        before = driven_m[:1] if is_first else np.asarray(self._last_m)[None]
        moved = np.diff(np.concatenate([before, driven_m])[int(is_first) :], axis=0)
        durations_s = np.diff([self._last_s, *time_s])[int(is_first) :]
        steps = np.abs(moved)
        noise = self._errors.travel_noise_m * np.sqrt(steps) * self._rng.standard_normal(steps.shape)
        wandered = self._wandered_m + np.cumsum(noise, axis=0)
        scrubbed = self._scrubbed_m + np.cumsum(self._scrubbing(moved, durations_s), axis=0)
        self._last_s, self._last_m = time_s[-1], driven_m[-1]
        if len(wandered):
            self._wandered_m, self._scrubbed_m = wandered[-1], scrubbed[-1]
        way = driven_m + np.concatenate([np.zeros((int(is_first), 2)), wandered + scrubbed]) + slipped_m
        turns = way / (2 * np.pi * np.array(self._robot.wheel_radius_m))
        ticks = turns * self._robot.ticks_per_turn + self._errors.tick_noise * self._rng.standard_normal(turns.shape)
        if is_first:
            self._offset = self._rng.integers(2**31 - 60_000, 2**31 - 20_000, 2)
        return Encoders(time_s, np.floor(ticks).astype(np.int64) + self._offset)

    def _scrubbing(self, moved_m: np.ndarray, durations_s: np.ndarray) -> np.ndarray:
        """Way by which the wheels turn further over steps in which the robot turns, (N, 2) of (N, 2) and (N,)."""
        turn_rates = np.abs(moved_m[:, 1] - moved_m[:, 0]) / (self._robot.wheel_base_m * durations_s)
        return self._errors.turn_slip * turn_rates[:, None] * moved_m


def read_encoders(
    motion: Motion,
    robot: RobotDescription,
    errors: WheelErrors,
    events: Sequence[Event],
    time_s: np.ndarray,
    rng: np.random.Generator,
) -> Encoders:
    """Readings over a planned drive, which the robot follows whatever its wheels do.

    Args:
        motion: of the base.
        robot: its real dimensions.
        errors: noise of wheels and readings.
        events: only slips are used; the left wheel slips.
        time_s: (N,) when they are read.
        rng: for the noise and the first counter values.
    """
    yaw = motion.poses(time_s)[:, 2]
    turned = (yaw - yaw[0]) * robot.wheel_base_m / 2
    driven = motion.travel_m(time_s)[:, None] + turned[:, None] * (-1.0, 1.0)
    slipped = np.stack([_slipped(motion, robot.wheel_base_m, events, time_s), np.zeros(len(time_s))], axis=1)
    return EncoderPair(robot, errors, rng).read(time_s, driven, slipped)


def _slipped(motion: Motion, wheel_base_m: float, events: Sequence[Event], time_s: np.ndarray) -> np.ndarray:
    """Distance that the left wheel has turned by slipping, (N,)."""
    fine = np.arange(0.0, motion.duration_s + STEP_S, STEP_S)
    speed, yaw_rate = motion.rates(fine).T
    wheel_speed = speed - yaw_rate * wheel_base_m / 2
    share = slip_share(events, fine)
    lost = np.cumsum(wheel_speed * share / (1.0 - share)) * STEP_S
    return np.interp(time_s, fine, lost)
