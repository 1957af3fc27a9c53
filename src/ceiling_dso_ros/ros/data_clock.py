"""The stamps of a stream in order, also where the clock that they come from is set back.

Everything behind the servers counts on stamps that grow. They do, on an inner clock: that of the data, plus an offset
that changes when the data's clock is set back. Outputs carry the data's own stamps.
"""

import bisect
import enum
from typing import List, NamedTuple, Optional

BACKWARDS_NS = 500_000_000  # a stamp further back than this is no sample out of order: the clock was set back


class StampKind(enum.Enum):
    """How a stamp follows on the last one. A jump ahead is a pause, which cannot be told from it."""

    NEXT = "later than the last one"
    REPEATED = "that of the last one"
    LATE = "before that of the last one"
    BACK = "far before that of the last one"  # a bag is played again, or somebody has set the clock


class Era(NamedTuple):
    """The time from one setting of the clock to the next."""

    begin_ns: int  # on the inner clock
    offset_ns: int  # inner clock minus the data's


class DataClock:
    """Follows the stamps of one stream; other streams that are stamped by the same clock can be brought onto its time.

    While the clock is not set back, inner stamps are those of the data.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Begin with the next stamp, whatever it is."""
        self._eras: List[Era] = [Era(0, 0)]
        self._last_ns: Optional[int] = None  # on the inner clock
        self._interval_ns = 1

    @property
    def last_ns(self) -> Optional[int]:
        """Inner time of the latest stamp, None before the first."""
        return self._last_ns

    def behind_s(self, stamp_ns: int) -> float:
        """Seconds by which a stamp lies before the latest one; 0 before the first."""
        return 0.0 if self._last_ns is None else (self._last_ns - stamp_ns - self._eras[-1].offset_ns) / 1e9

    def take(self, stamp_ns: int) -> StampKind:
        """Tell what kind of stamp this is; time goes on only with NEXT."""
        inner_ns = stamp_ns + self._eras[-1].offset_ns
        if self._last_ns is None or inner_ns > self._last_ns:
            if self._last_ns is not None:
                self._interval_ns = inner_ns - self._last_ns
            self._last_ns = inner_ns
            return StampKind.NEXT
        if inner_ns == self._last_ns:
            return StampKind.REPEATED
        return StampKind.LATE if self._last_ns - inner_ns <= BACKWARDS_NS else StampKind.BACK

    def set_back(self, stamp_ns: int) -> None:
        """Go on from a stamp that is BACK. How much time has passed is unknown: as much as between the last two."""
        if self._last_ns is None:  # nothing lies before the first stamp
            return
        self._last_ns += self._interval_ns
        self._eras.append(Era(self._last_ns, self._last_ns - stamp_ns))

    def inner_ns(self, stamp_ns: int) -> int:
        """A stamp of any stream on the inner clock.

        While streams pass from one era to the next, it is taken to be of that in which it is nearer to now.
        """
        candidates = [stamp_ns + era.offset_ns for era in self._eras[-2:]]
        return min(candidates, key=lambda inner_ns: abs(inner_ns - (self._last_ns or inner_ns)))

    def stamp_ns(self, inner_ns: int) -> int:
        """The data's stamp at a time of the inner clock, the inverse of `inner_ns`."""
        era = bisect.bisect_right([era.begin_ns for era in self._eras], inner_ns) - 1
        return inner_ns - self._eras[max(era, 0)].offset_ns
