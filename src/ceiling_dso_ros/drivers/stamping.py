# SPDX-License-Identifier: BSD-3-Clause
"""From images as they were captured to images with stamps of this computer's clock."""

from typing import NamedTuple, Optional, Tuple

import numpy as np

from ceiling_dso_ros.drivers.device_clock import DeviceClock
from ceiling_dso_ros.drivers.image_times import COUNTER_US, StampSource, before_readout
from ceiling_dso_ros.drivers.reports import CapturedImages

CLOCK_SET_NS = 500_000_000  # a stamp that is further back: this computer's clock was set
LONGEST_GAP = 100_000  # images; a larger one is not a gap, the camera counts anew


class StampedImages(NamedTuple):
    """Images of one moment.

    Attributes:
        stamp_ns: nanoseconds, the middle of the exposure if that is known, see `StampSource`.
        exposure_ms: exposure time; None if unknown.
        images: (H, W) uint8 of the left camera, and of the right one with stereo.
    """

    stamp_ns: int
    exposure_ms: Optional[float]
    images: Tuple[np.ndarray, ...]


class ImageStamper:
    """Stamps the images of a camera, counts those that are missing, and leaves out those whose stamps do not grow.

    The images of the first second after a connection are left out: until then their stamps are not good, nor is the
    automatic exposure.

    Attributes:
        dropped: images that the camera counted and that did not arrive.
        refused: images that arrived and have no usable stamp.
        source: what the last stamp is; None before the first.
    """

    def __init__(self) -> None:
        self.dropped = self.refused = 0
        self.source: Optional[StampSource] = None
        self._last_ns = 0
        self.connected()

    def connected(self) -> None:
        """Another connection of the camera: its counters begin anew."""
        self.clock = DeviceClock()
        self._ahead_ns = 0
        self._number: Optional[int] = None

    def stamp(self, captured: CapturedImages) -> Optional[StampedImages]:
        """The images with their stamp; None if they are left out."""
        self._count(captured.number)
        times, arrival = captured.times, captured.arrival
        before_us, self.source = before_readout(times)
        self._ahead_ns = arrival.ahead_ns
        if not times.of_device:
            stamp_ns = round(1e6 * times.timestamp_ms) - 1000 * before_us
        elif not self.clock.add(times.counter_us % COUNTER_US, arrival.raw_ns):
            self.refused += 1
            return None
        elif not self.clock.is_settled:
            return None
        else:
            stamp_ns = self.host_ns(times.counter_us - before_us)
        if self._last_ns - CLOCK_SET_NS < stamp_ns <= self._last_ns:
            self.refused += 1
            return None
        self._last_ns = stamp_ns
        return StampedImages(stamp_ns, times.exposure_ms, captured.images)

    def host_ns(self, counter_us: int) -> int:
        """The time of day of a moment near the last image, nanoseconds.

        Args:
            counter_us: the device's counter at that moment.
        """
        return self.clock.host_ns(counter_us % COUNTER_US) + self._ahead_ns

    def _count(self, number: int) -> None:
        if self._number is not None and 1 < number - self._number < LONGEST_GAP:
            self.dropped += number - self._number - 1
        self._number = number
