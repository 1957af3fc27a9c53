# SPDX-License-Identifier: BSD-3-Clause
"""Gives increasing stamps for a stream, also if its clock is set back.

The code behind the servers requires increasing stamps. They are taken from an inner clock: the clock of the data plus
an offset that changes when that clock is set back. Published messages have the original stamps of the data; recorded
trajectories have those of the inner clock, because a file's stamps must increase.
"""

import bisect
import enum
from typing import List, NamedTuple, Optional, Tuple

from ceiling_dso_ros.dso.durations import seconds

MOST_ERAS = 100  # that are kept: stamps that are still converted are younger
LONGEST_PAUSE_NS = 30 * 86_400 * 10**9  # beyond it, stamps are wrong; many of them must not add up to centuries
BACKWARDS_NS = 500_000_000  # a larger jump backwards: the clock was set back
# A smaller one: a sample out of order, unless so many follow it in their order, and are still so late. What changes
# places in a network does so by less.
FOLLOWERS, STILL_LATE_NS = 3, 100_000_000
# Or one follows it in its order and at its time: what was held up arrives all at once. By this share of the interval.
PACE = 0.5


class StampKind(enum.Enum):
    """Relation of a stamp to the last one.

    A jump forward is treated as a pause, because the two look the same, unless no node has ever paused for so long.
    """

    NEXT = "later than the last one"
    REPEATED = "that of the last one"
    LATE = "before that of the last one"
    BACK = "far before that of the last one"  # a bag is played again, or somebody has set the clock
    DOUBTED = "far from that of the last one, and alone"  # of a simulated time, see `RunClock`


class Era(NamedTuple):
    """The time between two changes of the clock."""

    begin_ns: int  # on the inner clock
    offset_ns: int  # inner clock minus the data's


class DataClock:
    """Follows the stamps of one stream; stamps of other streams with the same clock can be converted to its time.

    While the clock is not set back, inner stamps are those of the data.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Begin with the next stamp, whatever it is."""
        self._eras: List[Era] = [Era(0, 0)]
        self._last_ns: Optional[int] = None  # on the inner clock
        self._interval_ns = 1
        # The latest stamps, as long as they are late and in their order, with their arrivals.
        self._late: List[Tuple[int, Optional[int]]] = []

    @property
    def last_ns(self) -> Optional[int]:
        """Inner time of the latest stamp, None before the first."""
        return self._last_ns

    def ahead_ns(self, stamp_ns: int) -> int:
        """Nanoseconds by which a stamp lies after the latest one, negative before it; 0 before the first."""
        return 0 if self._last_ns is None else stamp_ns + self._eras[-1].offset_ns - self._last_ns

    def behind_s(self, stamp_ns: int) -> float:
        """Seconds by which a stamp lies before the latest one; 0 before the first."""
        return seconds(-self.ahead_ns(stamp_ns))

    def take(self, stamp_ns: int, arrival_ns: Optional[int] = None) -> StampKind:
        """Classify a stamp; only NEXT advances the time.

        Args:
            stamp_ns: of the data.
            arrival_ns: when it was received, by a clock that is never set; None if that is not known.
        """
        inner_ns = stamp_ns + self._eras[-1].offset_ns
        if self._last_ns is not None and inner_ns - self._last_ns > LONGEST_PAUSE_NS:
            self._begin_era(self._last_ns, stamp_ns)
            return StampKind.NEXT
        if self._last_ns is None or inner_ns > self._last_ns:
            if self._last_ns is not None:
                self._interval_ns = min(inner_ns - self._last_ns, BACKWARDS_NS)
            self._last_ns, self._late = inner_ns, []
            return StampKind.NEXT
        if inner_ns == self._last_ns:
            return StampKind.REPEATED
        in_order = self._late and inner_ns > self._late[-1][0]
        self._late = [*self._late[-FOLLOWERS:], (inner_ns, arrival_ns)] if in_order else [(inner_ns, arrival_ns)]
        follow = len(self._late) > FOLLOWERS and self._last_ns - inner_ns > STILL_LATE_NS
        is_back = follow or self._last_ns - inner_ns > BACKWARDS_NS or self._late_in_time()
        return StampKind.BACK if is_back else StampKind.LATE

    def _late_in_time(self) -> bool:
        """Whether the late stamps have arrived one by one, as they were made."""
        (first_ns, heard_first_ns), (last_ns, heard_last_ns) = self._late[0], self._late[-1]
        if heard_first_ns is None or heard_last_ns is None or last_ns == first_ns:
            return False
        return heard_last_ns - heard_first_ns >= PACE * (last_ns - first_ns)

    def set_back(self, stamp_ns: int, elapsed_ns: int = 0) -> None:
        """Continue from a stamp that is BACK.

        Args:
            stamp_ns: the stamp.
            elapsed_ns: time since the last one that was NEXT. At least the last two stamps' interval has elapsed.
        """
        if self._last_ns is not None:  # nothing lies before the first stamp
            self._begin_era(self._last_ns, stamp_ns, elapsed_ns)

    def _begin_era(self, last_ns: int, stamp_ns: int, elapsed_ns: int = 0) -> None:
        late_ns = self._late[-1][0] - self._late[0][0] if self._late else 0
        self._last_ns, self._late = last_ns + max(self._interval_ns + late_ns, elapsed_ns), []
        self._eras.append(Era(self._last_ns, self._last_ns - stamp_ns))
        del self._eras[:-MOST_ERAS]

    def inner_ns(self, stamp_ns: int) -> int:
        """A stamp of any stream on the inner clock.

        While the streams change from one era to the next, the era is chosen that gives the time nearer to now.
        """
        candidates = [stamp_ns + era.offset_ns for era in self._eras[-2:]]
        return min(candidates, key=lambda inner_ns: abs(inner_ns - (self._last_ns or inner_ns)))

    def stamp_ns(self, inner_ns: int) -> int:
        """The data's stamp at a time of the inner clock, the inverse of `inner_ns`."""
        era = bisect.bisect_right([era.begin_ns for era in self._eras], inner_ns) - 1
        return inner_ns - self._eras[max(era, 0)].offset_ns
