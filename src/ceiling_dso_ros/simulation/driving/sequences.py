# SPDX-License-Identifier: BSD-3-Clause
"""The sequences that can be simulated, by name: paths in a hall of 21 x 15 m or larger.

Tours lead all over the floor and come back to their places at other yaws. They start anywhere on their way, in either
direction. They need a floor on which nothing stands, that of a random hall.
"""

from typing import Callable, Dict, List, NamedTuple, Tuple

import numpy as np
from scipy.interpolate import CubicSpline

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


class Tour(NamedTuple):
    """Limits, and a closed curve in the hall: x and y of (N,) parameters that go from 0 to 2 pi once around."""

    limits: DriveLimits
    point: Callable[[np.ndarray], Tuple[np.ndarray, np.ndarray]]


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


AISLES = (
    (-5.5, -4.2), (0.0, -4.2), (5.5, -4.2), (6.6, -2.8), (5.5, -1.4), (0.0, -1.4), (-4.5, -1.4), (-5.5, 0.0),
    (-4.5, 1.4), (0.0, 1.4), (5.5, 1.4), (6.6, 2.8), (5.5, 4.2), (0.0, 4.2), (-5.5, 4.2), (-7.2, 2.5), (-7.4, 0.0),
    (-7.2, -2.5),
)  # fmt: skip


def _aisles(t: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """Four parallel aisles of 11 m, driven in turns forth and back, and the way back to the first one."""
    curve = CubicSpline(np.linspace(0.0, 2 * np.pi, len(AISLES) + 1), [*AISLES, AISLES[0]], bc_type="periodic")
    x, y = curve(t % (2 * np.pi)).T
    return x, y


def _eights(t: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """A figure eight all over the hall."""
    return 6.6 * np.sin(t), 4.0 * np.sin(2 * t)


def _weave(t: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """A curve that crosses itself all over the hall, at many angles."""
    return 6.6 * (0.4 * np.cos(2 * t) + 0.6 * np.cos(5 * t)), 4.3 * (0.4 * np.sin(2 * t) + 0.6 * np.sin(5 * t))


SEQUENCES: Dict[str, Sequence] = {
    "square": Sequence(np.array([0.0, -4.7, 0.0]), DriveLimits(speed_m_s=1.2), _square),
    "loops": Sequence(np.array([0.0, -3.75, 0.0]), DriveLimits(speed_m_s=1.1, yaw_rate_rad_s=0.8), _loops),
    "straight": Sequence(np.array([-6.5, 0.8, 0.0]), DriveLimits(speed_m_s=1.4), _straight),
    "spin": Sequence(np.array([-1.0, 1.2, 0.4]), DriveLimits(), _spin),
    "stop_and_go": Sequence(np.array([-1.6, -1.6, 0.0]), DriveLimits(acceleration_m_s2=0.8), _stop_and_go),
}

TOURS: Dict[str, Tour] = {
    "aisles": Tour(DriveLimits(speed_m_s=1.2), _aisles),
    "eights": Tour(DriveLimits(speed_m_s=1.2), _eights),
    "weave": Tour(DriveLimits(speed_m_s=1.2), _weave),
}

FIRST_REST_S = 1.0


def drawn_sequence(name: str, rng: np.random.Generator) -> Sequence:
    """A sequence or a tour with a random start: near its own, or anywhere on the tour."""
    if name in SEQUENCES:
        sequence = SEQUENCES[name]
        return sequence._replace(start=sequence.start + rng.uniform(-1.0, 1.0, 3) * (0.3, 0.3, 0.05))
    tour, first, sense = TOURS[name], rng.uniform(0.0, 2 * np.pi), rng.choice([-1.0, 1.0])

    def point(t: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        return tour.point(first + sense * t)

    (x, ahead_x), (y, ahead_y) = point(np.array([0.0, 1e-6]))
    start = np.array([x, y, np.arctan2(ahead_y - y, ahead_x - x)])
    return Sequence(start, tour.limits, lambda laps: [closed_curve(point, laps)])


def plan(name: str, duration_s: float, rng: np.random.Generator) -> Motion:
    """The motion of a sequence, at least duration_s long; the start pose differs with every seed.

    Args:
        name: one of SEQUENCES or TOURS.
        duration_s: wanted length, 0 for one lap.
        rng: for the start.
    """
    sequence = drawn_sequence(name, rng)
    laps = 1
    while True:
        motion = Motion(sequence.start, [Wait(FIRST_REST_S), *sequence.legs(laps), Wait(0.5)], sequence.limits)
        if motion.duration_s >= duration_s:
            return motion
        laps = max(laps + 1, int(laps * duration_s / motion.duration_s) + 1)
