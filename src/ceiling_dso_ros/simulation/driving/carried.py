# SPDX-License-Identifier: BSD-3-Clause
"""A robot that is carried to other places while it follows its plan: its wheels tell nothing of that."""

from dataclasses import dataclass
from typing import List, Sequence, Tuple

import numpy as np

from ceiling_dso_ros.simulation.driving.motion import BaseMotion, Motion
from ceiling_dso_ros.simulation.events import Event, of_kind

STEP_S = 0.1  # between the poses of the plan that must lie in the hall
WALL_M = 1.0  # to which no pose comes nearer
LEAST_WAY_M = 2.0
MOST_DRAWS = 1000


@dataclass(frozen=True)
class Carry:
    """The robot is lifted, carried, and set down.

    Attributes:
        event: when.
        pivot_xy: (2,) metres, where it is lifted.
        shift_m: (2,) from there to where it is set down.
        turn_rad: about the pivot.
    """

    event: Event
    pivot_xy: np.ndarray
    shift_m: np.ndarray
    turn_rad: float

    def moved(self, time_s: np.ndarray, poses: np.ndarray) -> np.ndarray:
        """Poses x, y, yaw as the plan has them, (N, 3) at (N,) times, with the robot carried."""
        share = np.clip((time_s - self.event.start_s) / self.event.duration_s, 0.0, 1.0)
        share = share**2 * (3.0 - 2.0 * share)  # from rest to rest
        turn = self.turn_rad * share
        (x, y), c, s = (poses[:, :2] - self.pivot_xy).T, np.cos(turn), np.sin(turn)
        xy = self.pivot_xy + np.column_stack([c * x - s * y, s * x + c * y]) + share[:, None] * self.shift_m
        return np.column_stack([xy, poses[:, 2] + turn])


class CarriedMotion:
    """A planned motion with a robot that is carried now and then.

    Args:
        planned: by which the wheels turn.
        carries: in the order of time.
    """

    def __init__(self, planned: Motion, carries: Sequence[Carry]) -> None:
        self._planned, self._carries = planned, carries

    def poses(self, time_s: np.ndarray) -> np.ndarray:
        """x, y, yaw (not wrapped): (N, 3) of (N,) times."""
        time_s = np.atleast_1d(time_s)
        poses = self._planned.poses(time_s)
        for carry in self._carries:
            poses = carry.moved(time_s, poses)
        return poses

    def rates(self, time_s: np.ndarray) -> np.ndarray:
        """Speed (m/s) and yaw rate (rad/s) of the plan, (N, 2): a robot that is carried does not shake by it."""
        return self._planned.rates(time_s)


def carried(
    planned: Motion, events: Sequence[Event], size_m: Tuple[float, float], rng: np.random.Generator
) -> BaseMotion:
    """The motion with all `kidnap` events: to places and directions from which the rest of the drive fits the hall.

    Args:
        planned: the drive.
        events: others are left out.
        size_m: of the hall, around the origin.
        rng: for the places. Where none is found, the robot is set down opposite, half a turn about the hall's centre.
    """
    carries: List[Carry] = []
    for event in of_kind(events, "kidnap"):
        so_far = CarriedMotion(planned, tuple(carries))
        rest = so_far.poses(np.arange(event.start_s, planned.duration_s + STEP_S, STEP_S))
        carries.append(_draw(event, rest, np.maximum(np.array(size_m) / 2 - WALL_M, 0.0), rng))
    return CarriedMotion(planned, carries) if carries else planned


def _draw(event: Event, rest: np.ndarray, half_m: np.ndarray, rng: np.random.Generator) -> Carry:
    pivot = rest[0, :2]
    after = np.full(len(rest), event.end_s)
    for _ in range(MOST_DRAWS):
        carry = Carry(event, pivot, rng.uniform(-half_m, half_m) - pivot, float(rng.uniform(-np.pi, np.pi)))
        far = np.hypot(*carry.shift_m) > LEAST_WAY_M
        if far and (np.abs(carry.moved(after, rest)[:, :2]) < half_m).all():
            return carry
    return Carry(event, pivot, -2.0 * pivot, np.pi)
