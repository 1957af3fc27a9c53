# SPDX-License-Identifier: BSD-3-Clause
"""Tells a clock that was set from messages that come late, by the times at which they arrive."""

from collections import deque
from statistics import median_low
from typing import Deque, Optional

TOLERANCE_NS = 50_000_000  # at 1 m/s, 5 cm; a busy computer holds messages up for as long
LEAK = 1e-4  # s/s by which what is known of the delay is forgotten: ten times what clocks drift apart
INTERVALS = 15  # of the last ones, whose median is the usual one
MANY_INTERVALS = 150  # of which the shortest is that of the sensor; a busy computer leaves some of its messages out
SETTLING = 30  # messages after a step, among which some have come without delay
FEWEST = 30  # intervals, before which nothing is known of the delay


class ArrivalClock:
    """Follows the clock by which a stream is stamped.

    No message arrives before it is sent. So stamp minus arrival has an upper limit, when nothing delays the message,
    and that limit steps when the clock is set. Messages that are delayed stay below it, but keep their distance in
    time. So it is a step if the limit changes and, at the same message, the interval between stamps is not the usual
    one: longer than usual, or shorter than any. What seemed to be a step back, and ends without a step, was a delay.

    Attributes:
        shift_ns: by how much the clock was set since it was `forget`: positive ahead, negative back.
    """

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Begin with the next message."""
        self.shift_ns = 0
        self._intervals_ns: Deque[int] = deque(maxlen=MANY_INTERVALS)  # without those of steps and swaps
        self._stamp_ns: Optional[int] = None
        self._arrival_ns = 0
        self._limit_ns = 0.0  # of stamp minus arrival
        self._after_step = (0, 0.0)  # shift and limit as they seemed right after the last step
        self._settling = 0

    @property
    def is_settled(self) -> bool:
        """The last step is known well."""
        return self._settling == 0

    def take(self, stamp_ns: int, arrival_ns: int) -> None:
        """Follow a message; its arrival is by a clock that is never set, nanoseconds."""
        lead_ns = stamp_ns - arrival_ns
        if self._stamp_ns is None:
            self._limit_ns = lead_ns
        else:
            stamps_ns, arrivals_ns = stamp_ns - self._stamp_ns, arrival_ns - self._arrival_ns
            self._limit_ns -= LEAK * max(arrivals_ns, 0)
            if not self._follow(lead_ns, stamps_ns, arrivals_ns) and stamps_ns > 0:
                self._intervals_ns.append(stamps_ns)
        self._stamp_ns, self._arrival_ns = stamp_ns, arrival_ns

    def _follow(self, lead_ns: int, stamps_ns: int, arrivals_ns: int) -> bool:
        """Whether it is a step."""
        step_ns = round(lead_ns - self._limit_ns)
        is_step = len(self._intervals_ns) >= FEWEST and self._is_step(step_ns, stamps_ns, arrivals_ns)
        if is_step:
            self._settling = SETTLING
        if is_step or step_ns > 0:
            self.shift_ns += step_ns if self._settling else 0
            self._limit_ns = lead_ns
        if is_step:
            self._after_step = self.shift_ns, self._limit_ns
        elif self.shift_ns < 0:
            shift_ns, limit_ns = self._after_step
            self.shift_ns = min(0, max(self.shift_ns, shift_ns + round(self._limit_ns - limit_ns)))
        self._settling = max(self._settling - 1, 0)
        return is_step

    def _is_step(self, step_ns: int, stamps_ns: int, arrivals_ns: int) -> bool:
        if abs(step_ns) <= TOLERANCE_NS:
            return False
        if step_ns > 0:
            usual_ns = median_low(list(self._intervals_ns)[-INTERVALS:])
            return stamps_ns - max(arrivals_ns, usual_ns) > TOLERANCE_NS
        return stamps_ns - min(arrivals_ns, *self._intervals_ns) < -TOLERANCE_NS


class ClockAgreement:
    """Whether two streams that once had the same clock, or a constant offset, still have."""

    def __init__(self) -> None:
        self._images, self._wheels = ArrivalClock(), ArrivalClock()

    def forget(self) -> None:
        """Begin with the next messages, which agree."""
        self._images.forget()
        self._wheels.forget()

    def take_image(self, stamp_ns: int, arrival_ns: int) -> None:
        """Follow an image; see `ArrivalClock.take`."""
        self._images.take(stamp_ns, arrival_ns)
        self._settle()

    def take_wheels(self, stamp_ns: int, arrival_ns: int) -> None:
        """Follow a wheel sample; see `ArrivalClock.take`."""
        self._wheels.take(stamp_ns, arrival_ns)
        self._settle()

    @property
    def apart_ns(self) -> int:
        """By how much the images' clock is ahead of that of the wheels, more than at first; 0 while they agree."""
        apart_ns = self._images.shift_ns - self._wheels.shift_ns
        return apart_ns if abs(apart_ns) > TOLERANCE_NS else 0

    @property
    def disagreement(self) -> str:
        """Which clock was set by how much while the other was not, in words; empty while they agree."""
        if not self.apart_ns:
            return ""
        streams = [("images", self._images.shift_ns), ("wheels", self._wheels.shift_ns)]
        (other, _), (stream, _) = sorted(streams, key=lambda each: abs(each[1]))
        # Where both were set by different times, what counts is the difference.
        ahead_ns = self.apart_ns if stream == "images" else -self.apart_ns
        return set_alone(stream, other, ahead_ns)

    def _settle(self) -> None:
        """What is left of steps that agree is the noise of the delays."""
        if not self.apart_ns and self._images.is_settled and self._wheels.is_settled:
            self._images.shift_ns = self._wheels.shift_ns = 0


def set_alone(stream: str, other: str, ahead_ns: int) -> str:
    """That the clock of one stream was set and that of another was not, in words."""
    way = "ahead" if ahead_ns > 0 else "back"
    return f"the clock of the {stream} was set {way} by {abs(ahead_ns) / 1e9:.2f} s, that of the {other} was not"
