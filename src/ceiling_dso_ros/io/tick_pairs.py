# SPDX-License-Identifier: BSD-3-Clause
"""Pairs the readings of two wheels from separate messages, in the same way for nodes and offline runs."""

from typing import Dict, Generic, Optional, Tuple, TypeVar

MAX_SKEW_NS = 50_000_000  # between the messages of the two wheels

Reading = TypeVar("Reading", int, float)


class TickPairs(Generic[Reading]):
    """Combines the newest readings of both wheels, counters or angles; each is used once.

    A reading that lies nearer to the next one of the other wheel than to its last one waits for that.

    Attributes:
        unpaired: how many readings were not used because the other wheel had none in time.
    """

    def __init__(self) -> None:
        self.unpaired = 0
        self._waiting: Dict[str, Tuple[int, Reading]] = {}
        self._last_ns: Dict[str, int] = {}

    def add(self, side: str, stamp_ns: int, reading: Reading) -> Optional[Tuple[int, Reading, Reading]]:
        """Add the reading of the `left` or `right` wheel.

        Args:
            side: left or right.
            stamp_ns: when it was read, nanoseconds; those of both wheels come in the order of time.
            reading: ticks or radians.

        Returns:
            The later stamp, left and right reading when both have arrived with near stamps, None until then.
        """
        self.unpaired += side in self._waiting
        self._waiting[side] = (stamp_ns, reading)
        interval_ns = stamp_ns - self._last_ns.get(side, stamp_ns - 2 * MAX_SKEW_NS)
        self._last_ns[side] = stamp_ns
        if len(self._waiting) < 2:
            return None
        (left_ns, left), (right_ns, right) = self._waiting["left"], self._waiting["right"]
        if abs(left_ns - right_ns) > min(MAX_SKEW_NS, interval_ns // 2):
            return None
        self._waiting.clear()
        return max(left_ns, right_ns), left, right
