# SPDX-License-Identifier: BSD-3-Clause
"""What a node does when the time of its data goes back."""

from typing import Callable, Optional

import rospy

from ceiling_dso_ros.dso.durations import nanoseconds
from ceiling_dso_ros.ros.data_clock import BACKWARDS_NS, DataClock, StampKind
from ceiling_dso_ros.ros.node import arrival_clock, time_is_simulated

USUAL_INTERVALS = 4  # a longer way from the last stamp, in intervals of the stream, is far


class RunClock(DataClock):
    """Clock of a run: a bag that is played again begins a new run, a clock that is set back on a robot does not.

    A new run forgets everything. So where time is simulated, a stamp that is far from the last one, in the past or in
    the future, is believed only when /clock agrees, or the next one follows it: a bag may contain a message with a
    wrong stamp.

    Attributes:
        is_simulated: time is that of a bag or a simulation.
    """

    def __init__(self, now_ns: Optional[Callable[[], int]] = None) -> None:
        """Begin with the next stamp.

        Args:
            now_ns: `arrival_clock`, unless it is that of a test.
        """
        self._usual_ns = 0  # last interval of the stream, which the next run has, too
        super().__init__()
        self.is_simulated = time_is_simulated()
        self._now_ns = now_ns or arrival_clock(self.is_simulated)
        self._heard_ns = self._now_ns()

    def reset(self) -> None:
        """Begin with the next stamp, whatever it is."""
        super().reset()
        self._doubted_ns: Optional[int] = None  # the last stamp, if it was far from the one before

    def follow(self, stamp_ns: int, begin_run: Callable[[], None]) -> StampKind:
        """Take a stamp, nanoseconds; when time went back, begin a new run, or continue on the inner clock.

        Args:
            stamp_ns: of the newest data. What is DOUBTED may not be used.
            begin_run: forgets the run so far; this clock is reset, too.
        """
        if self.is_simulated and self._is_doubted(stamp_ns):
            return StampKind.DOUBTED
        now_ns = self._now_ns()
        kind = self.take(stamp_ns, now_ns)
        elapsed_ns = now_ns - self._heard_ns
        if kind in (StampKind.NEXT, StampKind.BACK):
            self._heard_ns = now_ns
        if kind is StampKind.BACK:
            went_back = f"time went backwards by {self.behind_s(stamp_ns):.3f} s"
            if self.is_simulated and -self.ahead_ns(stamp_ns) > BACKWARDS_NS:
                rospy.logwarn(f"{went_back}: restarting")
                begin_run()
                self.reset()
                self.take(stamp_ns)
            else:
                rospy.logwarn(f"{went_back}: the clock was set back, the pose does not change")
                self.set_back(stamp_ns, elapsed_ns)
        return kind

    def _is_doubted(self, stamp_ns: int) -> bool:
        """Whether a stamp is far from the last one, and neither /clock nor another one of that time is known."""
        if self.last_ns is None:
            return False
        ahead_ns = self.ahead_ns(stamp_ns)
        if -BACKWARDS_NS <= ahead_ns <= max(BACKWARDS_NS, USUAL_INTERVALS * self._usual_ns):
            self._doubted_ns = None
            self._usual_ns = ahead_ns if ahead_ns > 0 else self._usual_ns
            return False
        if 4 * abs(stamp_ns - nanoseconds(rospy.get_time())) < abs(ahead_ns):
            self._doubted_ns = None
            return False
        before_ns, self._doubted_ns = self._doubted_ns, stamp_ns
        if before_ns is None or not 0 < stamp_ns - before_ns <= 2 * abs(self.ahead_ns(before_ns)):
            return True
        self._doubted_ns, self._usual_ns = None, stamp_ns - before_ns
        return False
