"""Counters of two wheels that come on topics of their own."""

from typing import Dict, NamedTuple, Optional

MAX_SKEW_S = 0.05


class WheelCounters(NamedTuple):
    """Both counters at a time."""

    stamp_s: float
    left: int
    right: int


class TickPairs:
    """Puts the newest counters of both wheels together; each is used once."""

    def __init__(self) -> None:
        self._waiting: Dict[str, tuple] = {}

    def add(self, side: str, stamp_s: float, ticks: int) -> Optional[WheelCounters]:
        """Take in the counter of the `left` or `right` wheel; returns both when they are there and belong together."""
        self._waiting[side] = (stamp_s, ticks)
        if len(self._waiting) < 2:
            return None
        (left_s, left), (right_s, right) = self._waiting["left"], self._waiting["right"]
        if abs(left_s - right_s) > MAX_SKEW_S:
            return None
        self._waiting.clear()
        return WheelCounters(max(left_s, right_s), left, right)
