# SPDX-License-Identifier: BSD-3-Clause
"""One stream of a sensor that measures angular rates and accelerations at different times."""

from collections import deque
from typing import Deque, Iterator, NamedTuple, Optional, Tuple

import numpy as np

from ceiling_dso_ros.drivers.image_times import COUNTER_US
from ceiling_dso_ros.drivers.reports import InertialReading

MOST_WAITING = 1000  # angular rates without an acceleration after them


class InertialSample(NamedTuple):
    """An angular rate, and the acceleration of the same moment.

    Attributes:
        counter_us: the device's counter.
        rate: (3,) rad/s.
        force: (3,) m/s^2.
    """

    counter_us: int
    rate: np.ndarray
    force: np.ndarray


class InertialPairs:
    """Interpolates the accelerations at the times of the angular rates."""

    def __init__(self) -> None:
        self._rates: Deque[InertialReading] = deque(maxlen=MOST_WAITING)
        self._force: Optional[InertialReading] = None

    def add(self, reading: InertialReading) -> Iterator[InertialSample]:
        """Take the next reading; yields what is known with it."""
        if reading.is_rate:
            self._rates.append(reading)
            return
        before, self._force = self._force, reading
        if before is None:
            self._rates.clear()
            return
        while self._rates and _between(self._rates[0], reading) >= 0:
            rate = self._rates.popleft()
            yield _pair(rate, (before, reading))


def _between(first: InertialReading, second: InertialReading) -> int:
    """Microseconds from one reading to another, across wrap-arounds of the counter."""
    return (second.counter_us - first.counter_us + COUNTER_US // 2) % COUNTER_US - COUNTER_US // 2


def _pair(rate: InertialReading, forces: Tuple[InertialReading, InertialReading]) -> InertialSample:
    before, after = forces
    share = np.clip(_between(before, rate) / max(_between(before, after), 1), 0.0, 1.0)
    force = (1.0 - share) * np.array(before.vector) + share * np.array(after.vector)
    return InertialSample(rate.counter_us, np.array(rate.vector), force)
