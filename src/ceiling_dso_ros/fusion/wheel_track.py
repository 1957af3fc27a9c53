# SPDX-License-Identifier: BSD-3-Clause
"""The recent wheel steps, which give the motion between any two recent stamps."""

from collections import deque
from typing import Deque, List, Optional, Sequence, Tuple

import numpy as np

from ceiling_dso_ros.dso.durations import nanoseconds
from ceiling_dso_ros.fusion.wheel_motion import WheelMotion, WheelNoise, WheelStep

HORIZON_S = 10.0


class WheelTrack:
    """Stores the steps of the last seconds, and the motion since a mark, however long ago it was set.

    Steps that become older than the horizon are folded into the motion since the mark, so that the memory does not grow
    while no mark is set. Images of a visual odometry arrive later than the wheels, by its computing time or, when it
    starts, by the time since its first keyframe: the horizon must cover that.
    """

    def __init__(self, noise: WheelNoise, horizon_s: float = HORIZON_S) -> None:
        self._noise = noise
        self._horizon_ns = nanoseconds(horizon_s)
        self._steps: Deque[WheelStep] = deque()
        self._motions: Deque[WheelMotion] = deque()  # of each step: they are asked for again and again
        self._since_mark = self._corrected = WheelMotion.nothing(0)  # until the first step sets a mark
        self._constants = np.zeros(2)

    @property
    def empty(self) -> bool:
        """No step yet."""
        return not self._steps

    @property
    def start_ns(self) -> int:
        """Stamp from which on the motion is remembered."""
        return self._steps[0].start_ns

    @property
    def end_ns(self) -> int:
        """Stamp of the newest sample."""
        return self._steps[-1].end_ns

    @property
    def newest(self) -> WheelStep:
        """The newest step."""
        return self._steps[-1]

    def add(self, step: WheelStep) -> None:
        """Append the newest step."""
        if self.empty:
            self.mark(step.start_ns, self._constants)
        self._steps.append(step)
        self._motions.append(self._noise.motion(step))
        while self._steps[0].end_ns < step.end_ns - self._horizon_ns:
            self._fold(self._steps.popleft(), self._motions.popleft())

    def steps(self, start_ns: int, end_ns: int) -> List[WheelStep]:
        """The remembered steps within [start_ns, end_ns], the outer ones cut."""
        return [part for part, _ in self._within(start_ns, end_ns)]

    def motion(self, start_ns: int, end_ns: int) -> WheelMotion:
        """The remembered motion within [start_ns, end_ns]."""
        return self._continued(WheelMotion.nothing(start_ns), end_ns)

    def turned(self, stamps_ns: np.ndarray) -> np.ndarray:
        """(N,) turn in rad from the first remembered stamp to each of (N,) int64 stamps in between."""
        ends_ns = np.array([self.start_ns, *(step.end_ns for step in self._steps)])
        turns_rad = np.cumsum([0.0, *(step.twist[2] for step in self._steps)])
        return np.interp(stamps_ns - self.start_ns, ends_ns - self.start_ns, turns_rad)

    def since_mark(self, end_ns: int) -> Optional[WheelMotion]:
        """The motion from the mark to a stamp; None when the stamp is before the mark, forgotten or still to come."""
        if self.empty or not self._since_mark.end_ns <= end_ns <= self.end_ns:
            return None
        return self._continued(self._since_mark, end_ns)

    def corrected_since_mark(self, end_ns: int) -> WheelMotion:
        """The same, of a stamp that `since_mark` accepts, by wheels with the mark's constants."""
        return self._extend(self._corrected, self._correct(self.steps(self._corrected.end_ns, end_ns)))

    def mark(self, stamp_ns: int, constants: np.ndarray) -> None:
        """Set a new mark.

        Args:
            stamp_ns: one that `since_mark` has accepted.
            constants: (2,) logarithms of wheel ratio and base relative to nominal, for `corrected_since_mark`.
        """
        self._since_mark = self._corrected = WheelMotion.nothing(stamp_ns)
        self._constants = constants

    def _continued(self, motion: WheelMotion, end_ns: int) -> WheelMotion:
        """A motion continued to a stamp."""
        for _, further in self._within(motion.end_ns, end_ns):
            motion = motion.then(further)
        return motion

    def _within(self, start_ns: int, end_ns: int) -> List[Tuple[WheelStep, WheelMotion]]:
        """The remembered steps within [start_ns, end_ns], the outer ones cut, with their motions."""
        newest_first = []
        for step, motion in zip(reversed(self._steps), reversed(self._motions)):
            if step.end_ns <= start_ns:
                break
            part = step.clip(start_ns, end_ns)
            if part is not None:
                newest_first.append((part, motion if part is step else self._noise.motion(part)))
        return newest_first[::-1]

    def _correct(self, steps: Sequence[WheelStep]) -> List[WheelStep]:
        return [self._noise.corrected(step, self._constants) for step in steps]

    def _extend(self, motion: WheelMotion, steps: Sequence[WheelStep]) -> WheelMotion:
        for step in steps:
            motion = self._noise.extend(motion, step)
        return motion

    def _fold(self, step: WheelStep, motion: WheelMotion) -> None:
        part = step.clip(self._since_mark.end_ns, step.end_ns)
        if part is not None:
            self._since_mark = self._since_mark.then(motion if part is step else self._noise.motion(part))
            self._corrected = self._extend(self._corrected, self._correct([part]))
