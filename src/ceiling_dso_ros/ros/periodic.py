# SPDX-License-Identifier: BSD-3-Clause
"""Work beside the callbacks, such as diagnostics, display and the disk."""

import threading
import time
import traceback
from typing import Callable, Set, Tuple

import rospy

SHORTEST_S = 0.01


class Periodic:
    """Does something again and again, by wall time, in a thread of its own, until the node is shut down.

    An exception does not end it. It is logged once, because it may well come again every time.

    Attributes:
        period_s: seconds between the end of the work and its next begin.
    """

    def __init__(self, work: Callable[[], None], period_s: float, name: str) -> None:
        self.period_s = period_s
        self._work, self._name = work, name
        self._known: Set[Tuple[type, str, int]] = set()
        self._end = threading.Event()
        rospy.on_shutdown(self._end.set)
        threading.Thread(target=self._go_on, name=name, daemon=True).start()

    def _go_on(self) -> None:
        while True:
            time.sleep(max(self.period_s, SHORTEST_S))  # not a wait for the end, see `waiting`
            if self._end.is_set():
                return
            try:
                self._work()
            except Exception as error:
                if not rospy.is_shutdown():  # topics are closed by then
                    self._tell(error)

    def _tell(self, error: Exception) -> None:
        frame = traceback.extract_tb(error.__traceback__)[-1]
        place = (type(error), frame.filename, frame.lineno or 0)
        if place not in self._known:
            self._known.add(place)
            rospy.logerr("%s failed and goes on: %s", self._name, traceback.format_exc())
