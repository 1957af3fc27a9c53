# SPDX-License-Identifier: BSD-3-Clause
"""The base as it is commanded: a velocity controller turns the wheels, and the wheels move the base.

This is the other way round than a planned drive, in which the base moves as planned and the wheels turn as they must.
The controller knows the nominal robot; a wheel that slips turns as commanded, and the base falls behind.
"""

from typing import List, Sequence, Tuple

import numpy as np

from ceiling_dso_ros.io.recording import RobotDescription
from ceiling_dso_ros.simulation.driving.motion import DriveLimits
from ceiling_dso_ros.simulation.events import Event, slip_share
from ceiling_dso_ros.simulation.obstacles import Obstacles

STEP_S = 0.01  # of the simulated time: half of what lies between two readings of the wheels
LIMITS = DriveLimits(speed_m_s=1.4, acceleration_m_s2=0.8, yaw_rate_rad_s=1.2, yaw_acceleration_rad_s2=2.0)
COMMAND_TIMEOUT_S = 0.5  # without a command the base stops, as drivers of real ones do
GRIP_LAG_S = 0.04  # how fast a wheel begins and ceases to slip: the base has mass
ROBOT_RADIUS_M = 0.35  # of the circle around base_link with which it touches obstacles
HISTORY = 200  # steps that are kept at least, longer than a sweep of the scanner or an exposure

# Columns of a state
X, Y, YAW, TRAVEL, DRIVEN_LEFT, DRIVEN_RIGHT, SLIPPED_LEFT, SLIPPED_RIGHT, SPEED, YAW_RATE = range(10)
RATES = [SPEED, YAW_RATE]
DRIVEN, SLIPPED = [DRIVEN_LEFT, DRIVEN_RIGHT], [SLIPPED_LEFT, SLIPPED_RIGHT]


class CommandedMotion:
    """The motion of base_link over a flat floor, step by step. Of the past, the last HISTORY steps are known.

    Args:
        start: x, y, yaw.
        nominal: the robot as its controller knows it.
        true: the robot as it is.
        events: slips count here, also those that are added later.
        obstacles: where the base cannot go; its wheels then turn on the spot.
    """

    def __init__(
        self,
        start: np.ndarray,
        nominal: RobotDescription,
        true: RobotDescription,
        events: Sequence[Event],
        obstacles: Obstacles,
    ) -> None:
        self._nominal, self._true, self._events, self._obstacles = nominal, true, events, obstacles
        self._target = np.zeros(2)
        self._commanded_s = -np.inf
        self._wanted = np.zeros(2)  # speed and yaw rate that the controller is at
        self._slip = 0.0
        self._steps = 0
        self._states: List[np.ndarray] = [np.array([*start, *np.zeros(7)])]
        self._first = 0  # step of the first of them

    @property
    def now_s(self) -> float:
        """The end of the last step."""
        return self._steps * STEP_S

    def command(self, speed_m_s: float, yaw_rate_rad_s: float) -> None:
        """Set the velocity from the next step on, for COMMAND_TIMEOUT_S at most; too large values are cut off."""
        self._target = np.clip([speed_m_s, yaw_rate_rad_s], -self._largest_rates, self._largest_rates)
        self._commanded_s = self.now_s

    @property
    def _largest_rates(self) -> np.ndarray:
        return np.array([LIMITS.speed_m_s, LIMITS.yaw_rate_rad_s])

    def step(self) -> None:
        """Move on by STEP_S."""
        is_commanded = self.now_s - self._commanded_s < COMMAND_TIMEOUT_S - STEP_S / 2
        change = STEP_S * np.array([LIMITS.acceleration_m_s2, LIMITS.yaw_acceleration_rad_s2])
        self._wanted = self._wanted + np.clip(self._target * is_commanded - self._wanted, -change, change)
        now = self._states[-1]
        rim = self._rim_speeds()
        grip = np.array([1.0 - self._next_slip(), 1.0])
        after = self._moved(now, rim * grip, rim * (1.0 - grip))
        if self._is_blocked(now, after):
            after = self._moved(now, np.zeros(2), rim)
        self._states.append(after)
        self._steps += 1
        if len(self._states) > 2 * HISTORY:
            self._states = self._states[HISTORY:]
            self._first += HISTORY

    def _rim_speeds(self) -> np.ndarray:
        """Speeds of the wheels' rims, left and right: the controller's angular rates are those of the nominal robot."""
        speed, yaw_rate = self._wanted
        turned = yaw_rate * self._nominal.wheel_base_m / 2
        nominal = np.array([speed - turned, speed + turned])
        return nominal * np.array(self._true.wheel_radius_m) / np.array(self._nominal.wheel_radius_m)

    def _next_slip(self) -> float:
        target = slip_share(self._events, np.array([self.now_s]))[0]
        self._slip += STEP_S / GRIP_LAG_S * (target - self._slip)
        return self._slip

    def _moved(self, now: np.ndarray, ground: np.ndarray, slipping: np.ndarray) -> np.ndarray:
        """The state after a step, at whose end the wheels have these speeds over the ground and slip by these."""
        after = now.copy()
        after[RATES] = ground.mean(), (ground[1] - ground[0]) / self._true.wheel_base_m
        speed, yaw_rate = (now[RATES] + after[RATES]) / 2
        heading = now[YAW] + yaw_rate * STEP_S / 2
        after[[X, Y]] += speed * STEP_S * np.array([np.cos(heading), np.sin(heading)])
        after[YAW] += yaw_rate * STEP_S
        after[TRAVEL] += speed * STEP_S
        turned = yaw_rate * self._true.wheel_base_m / 2
        after[DRIVEN] += STEP_S * np.array([speed - turned, speed + turned])
        after[SLIPPED] += STEP_S * slipping
        return after

    def _is_blocked(self, now: np.ndarray, after: np.ndarray) -> bool:
        """Whether the step leads into an obstacle, or further into it."""
        points = np.stack([now[[X, Y]], after[[X, Y]]])
        before_m, after_m = self._obstacles.clearance_m(points, np.full(2, self.now_s))
        return bool(after_m < ROBOT_RADIUS_M and after_m < before_m)

    def poses(self, time_s: np.ndarray) -> np.ndarray:
        """x, y, yaw (not wrapped): (N, 3) of (N,) times, cubic between the steps."""
        before, after, share = self._around(time_s)
        rates = [_velocity(state) for state in (before, after)]
        p, q = share, 1.0 - share
        return (
            (1 + 2 * p) * q**2 * before[:, :3]
            + p**2 * (1 + 2 * q) * after[:, :3]
            + STEP_S * p * q * (q * rates[0] - p * rates[1])
        )

    def rates(self, time_s: np.ndarray) -> np.ndarray:
        """Speed (m/s) and yaw rate (rad/s): (N, 2)."""
        return self._linear(time_s, RATES)

    def wheel_ways_m(self, time_s: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Signed way that each wheel has rolled over the floor, and the way that it has slipped, (N, 2) each."""
        return self._linear(time_s, DRIVEN), self._linear(time_s, SLIPPED)

    def _linear(self, time_s: np.ndarray, columns: List[int]) -> np.ndarray:
        before, after, share = self._around(time_s)
        return (1.0 - share) * before[:, columns] + share * after[:, columns]

    def _around(self, time_s: np.ndarray) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The states before and after each time, (N, 10), and how far it is from the one to the other, (N, 1).

        Times outside of the history are moved to its ends.
        """
        states = np.array(self._states)
        position = np.clip(np.atleast_1d(time_s) / STEP_S - self._first, 0.0, len(states) - 1.0)
        index = np.minimum(position.astype(np.int64), max(len(states) - 2, 0))
        return states[index], states[np.minimum(index + 1, len(states) - 1)], (position - index)[:, None]


def _velocity(states: np.ndarray) -> np.ndarray:
    """Of x, y and yaw, (N, 3) of (N, 10) states."""
    yaw = np.ascontiguousarray(states[:, YAW])  # or the last bit depends on its place in memory
    speed = states[:, SPEED]
    return np.stack([speed * np.cos(yaw), speed * np.sin(yaw), states[:, YAW_RATE]], axis=1)
