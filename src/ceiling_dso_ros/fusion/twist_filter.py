# SPDX-License-Identifier: BSD-3-Clause
"""Forward speed and yaw rate now, from the wheels' steps and from the camera's motions, which come late."""

from collections import deque
from dataclasses import dataclass
from typing import Deque, Optional

import numpy as np
from filterpy.kalman import KalmanFilter

from ceiling_dso_ros.dso.durations import LONG_AGO_NS, nanoseconds, seconds
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.config import OutputConfig
from ceiling_dso_ros.fusion.wheel_motion import WheelNoise, WheelStep

ACCELERATION_LASTS_S = 0.3  # for how long a robot holds an acceleration: ramps of base drivers last some tenths
ONSET = 2.0  # ramps begin at once: with so much more acceleration in the model, one is found within two wheel samples
GATE_SIGMAS = 4.5  # passed by all but one in a hundred thousand
STANDS_S = 0.1  # wheels that have not turned for so long: the robot stands, and does not accelerate either
HISTORY_NS = nanoseconds(1.0)  # so late a slip may be noticed
GAP = 3.0  # a step so much longer than the mean one: samples are missing, or the wheels' clock was set ahead


@dataclass(frozen=True)
class MeanTwist:
    """A measurement: mean forward speed and yaw rate over a time.

    Attributes:
        taken_ns: when the filter took it in.
        start_ns, end_ns: the time.
        rate: (2,) m/s and rad/s.
        covariance: (2, 2) of it.
        of_wheels: measured by the wheels.
    """

    taken_ns: int
    start_ns: int
    end_ns: int
    rate: np.ndarray
    covariance: np.ndarray
    of_wheels: bool


@dataclass(frozen=True)
class _State:
    """Of the filter: estimate, covariance; time of the last wheel step that was used and the (2,) sigmas after it."""

    x: np.ndarray
    P: np.ndarray
    step_ns: int
    step_sigmas: np.ndarray


@dataclass(frozen=True)
class _Entry:
    measured: MeanTwist
    before: _State


class TwistFilter:
    """Kalman filter of the twist u = (forward speed, yaw rate) and the acceleration a of both.

    The acceleration is a first-order Gauss-Markov process with standard deviation s and time constant T:

        u' = a,    a' = -a / T + w,    E[w w'] = 2 s^2 / T

    A measurement is the mean twist over a time, which with constant acceleration is the twist at its middle. If that
    lies by d before the time of the filter, the measurement is of u - d a, and the change of the acceleration since
    adds 2 s^2 d^3 / (3 T) to its variance. So the mean over the wheels' last step does not lag, and an image that comes
    late is compared with the twist of its own time.
    """

    def __init__(self, config: OutputConfig, noise: WheelNoise) -> None:
        self._noise = noise
        self.configure(config)
        self._filter = KalmanFilter(dim_x=4, dim_z=2)
        self._filter.x = np.zeros((4, 1))
        self._filter.P = np.diag(np.append(self._accelerations, self._accelerations) ** 2)
        self._filter.inv = planar.inverse_2x2
        self._now_ns: Optional[int] = None
        self._moved_ns: Optional[int] = None  # the wheels have not turned since
        self._step_ns, self._step_sigmas = LONG_AGO_NS, np.zeros(2)
        self._history: Deque[_Entry] = deque()

    def configure(self, config: OutputConfig) -> None:
        """Let other accelerations count from now on."""
        self._largest = np.array([config.acceleration_m_s2, config.acceleration_rad_s2])
        self._accelerations = ONSET * self._largest

    @property
    def twist(self) -> np.ndarray:
        """(2,) m/s and rad/s."""
        return self._filter.x.ravel()[:2]

    @property
    def covariance(self) -> np.ndarray:
        """(2, 2)."""
        return self._filter.P[:2, :2]

    def covariance_after(self, time_s: float) -> np.ndarray:
        """(2, 2) after a time over which the robot may have changed its speed as fast as it can."""
        return self.covariance + np.diag((self._largest * time_s) ** 2)

    def advance(self, stamp_ns: int) -> None:
        """Go on to a stamp, nanoseconds, that is not before the last one."""
        if self._now_ns is not None and stamp_ns > self._now_ns:
            self._predict(seconds(stamp_ns - self._now_ns))
        self._now_ns = stamp_ns
        while self._history and self._history[0].measured.taken_ns < stamp_ns - HISTORY_NS:
            self._history.popleft()

    def add_step(self, step: WheelStep) -> bool:
        """Take in the wheels' step that ends now, unless the robot cannot have changed its speed so fast.

        Then a wheel slips. A change that lasts is believed as soon as there was time enough for it. Over a gap in the
        samples the distance is believed in any case, the mean speed is not if the clock was set ahead.

        Returns:
            Whether its distance is possible.
        """
        if self._moved_ns is None or step.twist.any():
            self._moved_ns = step.start_ns
        still_s = seconds(step.end_ns - self._moved_ns)
        # Wheels that stand still are within one tick for as long as they do.
        covariance = (self._noise.white(step) / step.duration_s**2 + self._noise.resolution / still_s**2)[::2, ::2]
        measured = MeanTwist(step.end_ns, step.start_ns, step.end_ns, step.rate[::2], covariance, of_wheels=True)
        possible = self._take_in(measured)
        if still_s > STANDS_S + step.duration_s:
            self._filter.x = np.zeros((4, 1))
            self._filter.P = np.kron(np.diag([1.0, still_s**-2]), covariance)
        return possible or self._is_gap(step)

    def add_rate(self, start_ns: int, end_ns: int, rate: np.ndarray, covariance: np.ndarray) -> None:
        """Take in (2,) mean forward speed and yaw rate over a time that the camera saw, with (2, 2) covariance."""
        if self._now_ns is not None:
            self._take_in(MeanTwist(self._now_ns, start_ns, end_ns, rate, covariance, of_wheels=False))

    def withdraw_steps(self, since_ns: int) -> None:
        """Undo the wheels' steps since a stamp, nanoseconds: they slipped."""
        now_ns, redone = self._now_ns, []
        while self._history and self._history[-1].measured.taken_ns > since_ns:
            redone.append(self._history.pop())
        if now_ns is None or not redone:
            return
        before = redone[-1].before
        self._filter.x, self._filter.P = before.x, before.P
        self._step_ns, self._step_sigmas = before.step_ns, before.step_sigmas
        self._now_ns = redone[-1].measured.taken_ns
        for entry in reversed(redone):
            self.advance(entry.measured.taken_ns)
            if not entry.measured.of_wheels:
                self._take_in(entry.measured)
        self.advance(now_ns)

    def _take_in(self, measured: MeanTwist) -> bool:
        """Use a measurement; False if the wheels say what is not possible."""
        before = _State(self._filter.x, self._filter.P, self._step_ns, self._step_sigmas)
        self._history.append(_Entry(measured, before))
        age_s = seconds(measured.taken_ns - measured.end_ns) + 0.5 * seconds(measured.end_ns - measured.start_ns)
        H = np.hstack([np.eye(2), -age_s * np.eye(2)])
        changed = 2.0 / (3.0 * ACCELERATION_LASTS_S) * self._accelerations**2 * age_s**3
        if measured.of_wheels:
            if not self._possible(measured, measured.rate - (H @ self._filter.x).ravel()):
                return False
            self._step_ns = measured.taken_ns
        self._filter.update(measured.rate.reshape(2, 1), R=measured.covariance + np.diag(changed), H=H)
        if measured.of_wheels:
            self._step_sigmas = np.sqrt(np.diag(self.covariance))
        return True

    def _is_gap(self, step: WheelStep) -> bool:
        """Whether a step, the newest in the history, is much longer than those before it."""
        steps = [entry.measured for entry in self._history if entry.measured.of_wheels][:-1]
        durations_s = [seconds(before.end_ns - before.start_ns) for before in steps]
        return bool(steps) and step.duration_s > GAP * float(np.mean(durations_s))

    def _possible(self, measured: MeanTwist, difference: np.ndarray) -> bool:
        """Whether the robot can have changed its twist by (2,) so much since the last wheel step that was used."""
        reachable = self._largest * seconds(measured.taken_ns - self._step_ns)
        sigmas = np.hypot(np.sqrt(np.diag(measured.covariance)), self._step_sigmas)
        return bool((np.abs(difference) <= reachable + GATE_SIGMAS * sigmas).all())

    def _predict(self, dt: float) -> None:
        stays = np.exp(-dt / ACCELERATION_LASTS_S)
        reached = ACCELERATION_LASTS_S * (1.0 - stays)
        F = np.block([[np.eye(2), reached * np.eye(2)], [np.zeros((2, 2)), stays * np.eye(2)]])
        of_acceleration = 1.0 - stays**2
        of_both = reached**2 / ACCELERATION_LASTS_S
        of_twist = 2.0 * ACCELERATION_LASTS_S * (dt - reached) - reached**2
        Q = np.kron(np.array([[of_twist, of_both], [of_both, of_acceleration]]), np.diag(self._accelerations**2))
        self._filter.predict(F=F, Q=Q)
