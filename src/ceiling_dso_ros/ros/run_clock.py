# SPDX-License-Identifier: BSD-3-Clause
"""What a node does when the time of its data goes back."""

from typing import Callable

import rospy

from ceiling_dso_ros.ros.data_clock import DataClock, StampKind
from ceiling_dso_ros.ros.node import time_is_simulated


class RunClock(DataClock):
    """Clock of a run: a bag that is played again begins a new run, a clock that is set back on a robot does not.

    Attributes:
        is_simulated: time is that of a bag or a simulation.
    """

    def __init__(self) -> None:
        super().__init__()
        self.is_simulated = time_is_simulated()

    def follow(self, stamp_ns: int, begin_run: Callable[[], None]) -> StampKind:
        """Take a stamp, nanoseconds; when time went back, begin a new run, or continue on the inner clock.

        Args:
            stamp_ns: of the newest data.
            begin_run: forgets the run so far; this clock is reset, too.
        """
        kind = self.take(stamp_ns)
        if kind is StampKind.BACK:
            went_back = f"time went backwards by {self.behind_s(stamp_ns):.3f} s"
            if self.is_simulated:
                rospy.logwarn(f"{went_back}: restarting")
                begin_run()
                self.reset()
                self.take(stamp_ns)
            else:
                rospy.logwarn(f"{went_back}: the clock was set back, the pose does not change")
                self.set_back(stamp_ns)
        return kind
