# SPDX-License-Identifier: BSD-3-Clause
"""The sequences that can be simulated, by name: paths in a hall of 21 x 15 m or larger."""

from typing import Callable, Dict, List, NamedTuple, Tuple

import numpy as np

from ceiling_dso_ros.simulation.driving.motion import (
    DriveLimits,
    Leg,
    Motion,
    Turn,
    Wait,
    closed_curve,
    rounded_square,
    straight,
)


class Sequence(NamedTuple):
    """Start pose (x, y, yaw), speed, and the legs as a function of the number of laps."""

    start: np.ndarray
    limits: DriveLimits
    legs: Callable[[int], List[Leg]]


def _square(laps: int) -> List[Leg]:
    """The paper's first: a square of about 8 m with round corners."""
    return [rounded_square(5.6, 3.0, laps)]


def _loops(laps: int) -> List[Leg]:
    """The paper's second: five small closed loops on a round through the hall."""

    def point(t: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        return 4.6 * np.sin(t) + 1.55 * np.sin(6 * t), -2.4 * np.cos(t) - 1.35 * np.cos(6 * t)

    return [closed_curve(point, laps)]


def _straight(laps: int) -> List[Leg]:
    """Along the hall; further laps go back and forth."""
    return [straight(13.0, backward=bool(lap % 2)) for lap in range(laps)]


def _spin(laps: int) -> List[Leg]:
    """Turns on the spot, both ways, with a short drive between."""
    there: List[Leg] = [Turn(2 * np.pi), Wait(1.0), straight(1.5)]
    back: List[Leg] = [Turn(-2 * np.pi), Wait(1.0), straight(1.5, backward=True)]
    return [*there, *back] * laps


def _stop_and_go(laps: int) -> List[Leg]:
    """Short drives with halts, a quarter turn after every second one; closes after four corners."""
    corner: List[Leg] = [straight(1.6), Wait(1.5), straight(1.6), Wait(0.7), Turn(np.pi / 2), Wait(0.4)]
    return corner * (4 * laps)


SEQUENCES: Dict[str, Sequence] = {
    "square": Sequence(np.array([0.0, -4.7, 0.0]), DriveLimits(speed_m_s=1.2), _square),
    "loops": Sequence(np.array([0.0, -3.75, 0.0]), DriveLimits(speed_m_s=1.1, yaw_rate_rad_s=0.8), _loops),
    "straight": Sequence(np.array([-6.5, 0.8, 0.0]), DriveLimits(speed_m_s=1.4), _straight),
    "spin": Sequence(np.array([-1.0, 1.2, 0.4]), DriveLimits(), _spin),
    "stop_and_go": Sequence(np.array([-1.6, -1.6, 0.0]), DriveLimits(acceleration_m_s2=0.8), _stop_and_go),
}

FIRST_REST_S = 1.0


def random_start(sequence: Sequence, rng: np.random.Generator) -> np.ndarray:
    """Start pose (x, y, yaw), near that of the sequence."""
    return sequence.start + rng.uniform(-1.0, 1.0, 3) * (0.3, 0.3, 0.05)


def plan(sequence: Sequence, duration_s: float, rng: np.random.Generator) -> Motion:
    """The motion of a sequence, at least duration_s long; the start pose differs a little with every seed.

    Args:
        sequence: one of SEQUENCES.
        duration_s: wanted length, 0 for one lap.
        rng: for the start.
    """
    start = random_start(sequence, rng)
    laps = 1
    while True:
        motion = Motion(start, [Wait(FIRST_REST_S), *sequence.legs(laps), Wait(0.5)], sequence.limits)
        if motion.duration_s >= duration_s:
            return motion
        laps = max(laps + 1, int(laps * duration_s / motion.duration_s) + 1)
