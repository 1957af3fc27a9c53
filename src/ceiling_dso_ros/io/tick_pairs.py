# SPDX-License-Identifier: BSD-3-Clause
"""Pairs the counters of two wheels from separate topics, in the same way for nodes and offline runs."""

from typing import Dict, NamedTuple, Optional, Tuple

MAX_SKEW_NS = 50_000_000  # between the messages of the two wheels


class WheelCounters(NamedTuple):
    """Both counters at a time."""

    stamp_ns: int
    left: int
    right: int


class TickPairs:
    """Combines the newest counters of both wheels; each is used once."""

    def __init__(self) -> None:
        self._waiting: Dict[str, Tuple[int, int]] = {}

    def add(self, side: str, stamp_ns: int, ticks: int) -> Optional[WheelCounters]:
        """Add the counter of the `left` or `right` wheel; returns a pair when both have arrived with near stamps.

        Args:
            side: left or right.
            stamp_ns: when the counter was read, nanoseconds; those of both wheels come in the order of time.
            ticks: the counter.
        """
        self._waiting[side] = (stamp_ns, ticks)
        if len(self._waiting) < 2:
            return None
        (left_ns, left), (right_ns, right) = self._waiting["left"], self._waiting["right"]
        if abs(left_ns - right_ns) > MAX_SKEW_NS:
            return None
        self._waiting.clear()
        return WheelCounters(max(left_ns, right_ns), left, right)
