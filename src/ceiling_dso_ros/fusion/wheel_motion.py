# SPDX-License-Identifier: BSD-3-Clause
"""Motions of a differential drive with covariance: a step is an arc driven with constant twist between two samples.

It is integrated exactly by `planar.expmap`. The motion over several steps keeps two sources of error separate: white
noise of the wheels, and the constants of the robot (mean radius, ratio of the radii, wheel base), with the derivative
of the pose by their logarithms.
"""

import math
from dataclasses import dataclass, replace
from typing import Optional

import numpy as np

from ceiling_dso_ros.dso.durations import seconds
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.config import WheelConfig

ANY_TURN_SIGMA = math.pi / math.sqrt(3.0)  # rad, of a heading of which nothing is known


@dataclass(frozen=True)
class WheelStep:
    """Motion of the wheels between two samples.

    Attributes:
        start_ns, end_ns: stamps of the samples, nanoseconds.
        twist: (3,) arc in the base frame at the start: forward m, left m, turn rad.
        known: False when the samples are not usable (a counter was restarted); the twist is then a guess.
    """

    start_ns: int
    end_ns: int
    twist: np.ndarray
    known: bool = True

    @property
    def duration_s(self) -> float:
        """Seconds."""
        return seconds(self.end_ns - self.start_ns)

    @property
    def rate(self) -> np.ndarray:
        """(3,) m/s, m/s, rad/s."""
        return self.twist / self.duration_s

    def clip(self, start_ns: int, end_ns: int) -> Optional["WheelStep"]:
        """The part of the step within [start_ns, end_ns]; None when nothing is."""
        start_ns, end_ns = max(start_ns, self.start_ns), min(end_ns, self.end_ns)
        if end_ns <= start_ns:
            return None
        if (start_ns, end_ns) == (self.start_ns, self.end_ns):
            return self
        return WheelStep(start_ns, end_ns, self.rate * seconds(end_ns - start_ns), self.known)


@dataclass(frozen=True)
class WheelMotion:
    """The motion over consecutive steps.

    Attributes:
        start_ns, end_ns: nanoseconds.
        pose: (3,) pose of the base at the end seen from the start.
        noise: (3, 3) covariance of the pose from white noise.
        jacobian: (3, 3) derivative of the pose by (ln mean radius, ln ratio right/left, ln wheel base).
    """

    start_ns: int
    end_ns: int
    pose: np.ndarray
    noise: np.ndarray
    jacobian: np.ndarray

    @property
    def duration_s(self) -> float:
        """Seconds."""
        return seconds(self.end_ns - self.start_ns)

    def then(self, further: "WheelMotion") -> "WheelMotion":
        """This motion and the one that follows it."""
        back = planar.adjoint(planar.inverse(further.pose))
        return WheelMotion(
            self.start_ns,
            further.end_ns,
            planar.compose(self.pose, further.pose),
            back @ self.noise @ back.T + further.noise,
            back @ self.jacobian + further.jacobian,
        )

    @staticmethod
    def nothing(stamp_ns: int) -> "WheelMotion":
        """No motion yet."""
        return WheelMotion(stamp_ns, stamp_ns, np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3)))


@dataclass
class WheelNoise:
    """The error model of one robot's wheels.

    Attributes:
        config: its settings.
        wheel_base_m: distance of the wheels.
        resolution_m: of a wheel's readings, on the floor: that of the ticks, or as it is found from other readings.
    """

    config: WheelConfig
    wheel_base_m: float
    resolution_m: float

    def white(self, step: WheelStep) -> np.ndarray:
        """(3, 3) covariance of the twist: the error of each wheel's distance is noise_m_per_sqrt_m sqrt(distance)."""
        forward, left, turn = step.twist
        half_base = 0.5 * self.wheel_base_m
        k2 = self.config.noise_m_per_sqrt_m**2
        var_left, var_right = k2 * abs(forward - half_base * turn), k2 * abs(forward + half_base * turn)
        var_forward = 0.25 * (var_left + var_right)
        covariance = np.diag([var_forward, 0.25 * var_forward + k2 * abs(left), var_forward / half_base**2])
        covariance[0, 2] = covariance[2, 0] = 0.25 * (var_right - var_left) / half_base
        if not step.known:  # any speed a robot may have, changing about every second
            sigma_m = self.config.max_speed_m_s / 3.0 * math.sqrt(step.duration_s)
            turn_sigma = min(sigma_m / half_base, ANY_TURN_SIGMA)
            aside = min(math.hypot(0.1, turn_sigma / math.sqrt(3.0)), 1.0)  # of the way, by a turn at a constant rate
            covariance += np.diag([sigma_m, aside * sigma_m, turn_sigma]) ** 2
        return covariance

    def sensitivity(self, twist: np.ndarray) -> np.ndarray:
        """(3, 3) derivative of the twist by (ln mean radius, ln ratio, ln wheel base)."""
        forward, left, turn = twist
        base = self.wheel_base_m
        return np.array([[forward, 0.25 * base * turn, 0.0], [left, 0.0, 0.0], [turn, forward / base, -turn]])

    def corrected(self, step: WheelStep, constants: np.ndarray) -> WheelStep:
        """The step by wheels with (2,) logarithms of ratio and base relative to nominal."""
        return replace(step, twist=step.twist + self.sensitivity(step.twist)[:, 1:] @ constants)

    def extend(self, motion: WheelMotion, step: WheelStep) -> WheelMotion:
        """The motion with one more step."""
        return motion.then(self.motion(step))

    def motion(self, step: WheelStep) -> WheelMotion:
        """The motion of one step."""
        J = planar.right_jacobian(step.twist)
        noise, jacobian = J @ self.white(step) @ J.T, J @ self.sensitivity(step.twist)
        return WheelMotion(step.start_ns, step.end_ns, planar.expmap(step.twist), noise, jacobian)

    def way_m(self, motion: WheelMotion) -> float:
        """Distance that the wheels rolled, for driving and turning separately, minus the distance rolled back."""
        return self.wheel_base_m * (abs(motion.jacobian[2, 1]) + 0.5 * abs(motion.jacobian[2, 2]))

    def constants_covariance(self, with_radius: bool) -> np.ndarray:
        """(3, 3) prior of (ln mean radius, ln ratio, ln wheel base); the radius taken as exact without with_radius."""
        config = self.config
        return np.diag([config.radius_sigma if with_radius else 0.0, config.ratio_sigma, config.base_sigma]) ** 2

    @property
    def resolution(self) -> np.ndarray:
        """(3, 3) covariance of a motion from the resolution of the readings at its two ends."""
        tick = self.resolution_m / math.sqrt(6.0)
        return np.diag([tick, tick, 2.0 * tick / self.wheel_base_m]) ** 2

    def covariance(self, motion: WheelMotion, constants: np.ndarray) -> np.ndarray:
        """(3, 3) covariance of a motion's pose, given the (3, 3) covariance of the constants."""
        return motion.noise + motion.jacobian @ constants @ motion.jacobian.T + self.resolution
