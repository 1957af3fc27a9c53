# SPDX-License-Identifier: BSD-3-Clause
"""The time on this computer's clock of what a device stamps with its own counter.

An image arrives later than it was taken, by a delay that is never negative and often small. So the differences between
the computer's clock on arrival and the device's have a lower envelope, which is a straight line: the clocks' offset,
with their drift as its slope (Moon, Skelly, Towsley: Estimation and removal of clock skew from network delay
measurements, INFOCOM 1999). The shortest delay cannot be told from the offset and remains in the result.
"""

from collections import deque
from typing import Deque, List, Optional, Tuple

from ceiling_dso_ros.drivers.image_times import COUNTER_US

WINDOW_NS = 60 * 10**9  # of the readings that count
BIN_NS = 500_000_000  # of each of these periods, the reading with the shortest delay counts
SETTLED_NS = 10**9  # with readings of a shorter time, the shortest delay may still be far from the usual shortest
SHORTEST_SPAN_NS = 6 * 10**9  # of the readings that determine a drift; 50 ppm are 0.3 ms until then
LARGEST_DRIFT = 1.5e-4  # of two quartz oscillators
LARGEST_STEP_NS = 5_000_000  # of the offset; a larger one is an error of a single reading, or must be confirmed
CONFIRMATIONS = 10  # readings in a row that say the same

Point = Tuple[int, int]  # device's time, offset


class DeviceClock:
    """Fits the device's clock to the computer's, from the arrivals of its images.

    A reading that contradicts all others by more than LARGEST_STEP_NS is refused: the counter goes backwards, or an
    image would have arrived before it was taken. CONFIRMATIONS of them in a row mean that the device's clock was set:
    the fit begins anew. Late arrivals need no such care, as the lower envelope does not see them.
    """

    def __init__(self) -> None:
        self._device_ns = 0  # of the latest reading, without wrap-arounds
        self._counter_us: Optional[int] = None  # the same as the device counts it
        self._refused = 0  # in a row
        self._begin()

    def _begin(self) -> None:
        self._bins: Deque[Point] = deque()
        self._start_ns: Optional[int] = None  # on the device's clock
        self._reference_ns, self._offset_ns, self._drift = 0, 0, 0.0

    @property
    def is_settled(self) -> bool:
        """Whether the readings so far are enough for stamps that are right to some tenths of a millisecond."""
        return self._start_ns is not None and self._device_ns - self._start_ns >= SETTLED_NS

    @property
    def drift(self) -> float:
        """By how much the computer's clock is faster than the device's, relative."""
        return self._drift

    def add(self, counter_us: int, arrival_ns: int) -> bool:
        """Take a reading.

        Args:
            counter_us: the device's counter, 32 bits; may have wrapped around since the last reading.
            arrival_ns: on the computer's clock, nanoseconds.

        Returns:
            False if it is refused.
        """
        device_ns = self._unwrapped_ns(counter_us)
        offset_ns = arrival_ns - device_ns
        is_first = self._start_ns is None
        contradicts = device_ns < self._device_ns or offset_ns < self._line_ns(device_ns) - LARGEST_STEP_NS
        if not is_first and contradicts and (self.is_settled or device_ns < self._device_ns):
            self._refused += 1
            if self._refused < CONFIRMATIONS:
                return False
            self._begin()
            is_first = True
        self._refused = 0
        self._device_ns, self._counter_us = device_ns, counter_us
        if is_first:
            self._start_ns = self._reference_ns = device_ns
            self._offset_ns = offset_ns
        self._offset_ns += min(0, offset_ns - self._line_ns(device_ns))  # nothing arrives before it is taken
        if self._put_into_bin(device_ns, offset_ns):
            self._fit()
        return True

    def host_ns(self, counter_us: int) -> int:
        """The computer's time of a moment near the latest reading, nanoseconds.

        Args:
            counter_us: the device's counter at that moment, 32 bits.
        """
        device_ns = self._unwrapped_ns(counter_us)
        return device_ns + self._line_ns(device_ns)

    def _unwrapped_ns(self, counter_us: int) -> int:
        if self._counter_us is None:
            return 1000 * counter_us
        step_us = (counter_us - self._counter_us + COUNTER_US // 2) % COUNTER_US - COUNTER_US // 2
        return self._device_ns + 1000 * step_us

    def _line_ns(self, device_ns: int) -> int:
        return self._offset_ns + round(self._drift * (device_ns - self._reference_ns))

    def _put_into_bin(self, device_ns: int, offset_ns: int) -> bool:
        """Store a reading if it is the lowest of its bin; True if it is the first of a new one."""
        bins = self._bins
        if bins and device_ns // BIN_NS == bins[-1][0] // BIN_NS:
            bins[-1] = min(bins[-1], (device_ns, offset_ns), key=lambda point: point[1])
            return False
        bins.append((device_ns, offset_ns))
        while device_ns - bins[0][0] > WINDOW_NS:
            bins.popleft()
        return True

    def _fit(self) -> None:
        """The highest line below all readings, in the mean; it moves the newest stamp by LARGEST_STEP_NS at most."""
        newest_ns = self._bins[-1][0]
        points = [(device_ns - newest_ns, offset_ns) for device_ns, offset_ns in self._bins]
        highest_ns = self._line_ns(newest_ns) + LARGEST_STEP_NS
        self._drift = _slope(points) if newest_ns - self._bins[0][0] >= SHORTEST_SPAN_NS else 0.0
        self._reference_ns = newest_ns
        self._offset_ns = min(highest_ns, min(round(y - self._drift * x) for x, y in points))


def _slope(points: List[Point]) -> float:
    """Slope of the edge of the lower convex hull that lies below the mean of x, within LARGEST_DRIFT."""
    hull: List[Point] = []
    for point in points:
        while len(hull) > 1 and _is_above(hull[-1], hull[-2], point):
            hull.pop()
        hull.append(point)
    middle = sum(x for x, _ in points) / len(points)
    (x0, y0), (x1, y1) = next(edge for edge in zip(hull, hull[1:]) if edge[1][0] >= middle)
    return max(-LARGEST_DRIFT, min(LARGEST_DRIFT, (y1 - y0) / (x1 - x0)))


def _is_above(point: Point, left: Point, right: Point) -> bool:
    """Whether a point lies on or above the line between its neighbours."""
    return (point[1] - left[1]) * (right[0] - left[0]) >= (right[1] - left[1]) * (point[0] - left[0])
