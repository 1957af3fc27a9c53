# SPDX-License-Identifier: BSD-3-Clause
"""When an image was taken: what the camera says of it, and the clocks of this computer."""

import enum
import time
from typing import NamedTuple, Optional, Tuple

COUNTER_US = 2**32  # the device counts microseconds in 32 bits: 71.6 minutes
LONGEST_EXPOSURE_US = 200_000
TRIES = 3
GOOD_NS = 20_000  # within which both clocks are read on a computer that is not interrupted meanwhile


class HostTime(NamedTuple):
    """A moment on this computer.

    Attributes:
        raw_ns: of the clock that nobody sets or slows down (CLOCK_MONOTONIC_RAW), nanoseconds.
        ahead_ns: what to add for the time of day, which stamps have, nanoseconds.
    """

    raw_ns: int
    ahead_ns: int


def host_time() -> HostTime:
    """Now. Both clocks are read at one moment, even if the process is interrupted in between."""
    readings = []
    for _ in range(TRIES):
        before_ns = time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)
        day_ns = time.time_ns()
        after_ns = time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)
        readings.append((after_ns - before_ns, before_ns, day_ns - (before_ns + after_ns) // 2))
        if after_ns - before_ns < GOOD_NS:
            break
    return HostTime(readings[0][1], min(readings)[2])


class StampSource(enum.Enum):
    """What the stamp of an image is, from best to worst."""

    MIDDLE = "the middle of the exposure, as the camera says"
    HALF = "the start of the readout less half the exposure time"
    READOUT = "the start of the readout: the camera does not say how long it exposed"
    ARRIVAL = "when the image reached this computer: the camera's own clock is not known"


class FrameTimes(NamedTuple):
    """What the library says of an image.

    Attributes:
        timestamp_ms: of the start of the readout, on the device's clock or the computer's.
        of_device: the timestamp is the device's, which counts up to COUNTER_US and begins again; else it is this
            computer's time of day.
        readout_us: the device's counter at the start of the readout; None if unknown, as all that follow.
        middle_us: the device's counter in the middle of the exposure.
        exposure_us: exposure time.
    """

    timestamp_ms: float
    of_device: bool
    readout_us: Optional[int] = None
    middle_us: Optional[int] = None
    exposure_us: Optional[int] = None

    @property
    def counter_us(self) -> int:
        """The timestamp in whole microseconds."""
        return round(1e3 * self.timestamp_ms)

    @property
    def exposure_ms(self) -> Optional[float]:
        """The exposure time in milliseconds; None if it is unknown or cannot be right."""
        is_known = self.exposure_us is not None and 0 < self.exposure_us <= LONGEST_EXPOSURE_US
        return self.exposure_us / 1e3 if is_known and self.exposure_us is not None else None


def before_readout(times: FrameTimes) -> Tuple[int, StampSource]:
    """Microseconds by which the middle of the exposure lies before the timestamp, and where they come from."""
    if times.of_device and times.readout_us is not None and times.middle_us is not None:
        before_us = (times.readout_us - times.middle_us) % COUNTER_US
        if before_us <= LONGEST_EXPOSURE_US:
            return before_us, StampSource.MIDDLE
    half_us = 0 if times.exposure_ms is None else round(500.0 * times.exposure_ms)
    if not times.of_device:
        return half_us, StampSource.ARRIVAL
    return half_us, StampSource.READOUT if times.exposure_ms is None else StampSource.HALF
