# SPDX-License-Identifier: BSD-3-Clause
"""/diagnostics, published by wall time, so also while a simulated clock or a bag is paused."""

import math
from collections import deque
from typing import Callable, Deque, Optional

import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper, Updater

from ceiling_dso_ros.io.errors import one_line
from ceiling_dso_ros.ros.periodic import Periodic

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
PERIOD_S = 0.4
SHOWN_S = 2.0  # a problem stays in the diagnostics for this time


class Stream:
    """Counts messages of one kind and stores the last problem. Seconds are ROS time."""

    def __init__(self, silence_s: float) -> None:
        self.received = self.rejected = 0
        self._silence_s = silence_s
        self._arrivals: Deque[float] = deque(maxlen=100)
        self._complaint, self._complaint_s = "", -math.inf

    def heard(self) -> None:
        """Count a message."""
        self.received += 1
        now_s = rospy.get_time()
        if self._arrivals and now_s < self._arrivals[-1]:
            self.forget_times()
        self._arrivals.append(now_s)

    def complain(self, complaint: str) -> None:
        """Count a message that could not be used."""
        self.rejected += 1
        self._complaint, self._complaint_s = one_line(complaint), rospy.get_time()

    def forget_times(self) -> None:
        """Time has been set back."""
        self._arrivals.clear()
        self._complaint_s = -math.inf

    @property
    def age_s(self) -> float:
        """Seconds since the last message, inf without one."""
        return max(0.0, rospy.get_time() - self._arrivals[-1]) if self._arrivals else math.inf

    @property
    def silent(self) -> bool:
        """Nothing has come for too long."""
        return self.age_s > self._silence_s

    @property
    def rate_hz(self) -> float:
        """Messages a second lately, 0 when silent."""
        arrivals = list(self._arrivals)
        if self.silent or len(arrivals) < 2 or arrivals[-1] <= arrivals[0]:
            return 0.0
        return (len(arrivals) - 1) / (arrivals[-1] - arrivals[0])

    @property
    def complaint(self) -> str:
        """The recent problem with a message, empty without one."""
        return self._complaint if 0.0 <= rospy.get_time() - self._complaint_s < SHOWN_S else ""

    def judge(self, status: DiagnosticStatusWrapper, name: str, silence_level: int = ERROR) -> None:
        """Merge the result into a status; a stream that has not begun and bad messages are warnings."""
        if not self.received:
            status.mergeSummary(WARN, f"waiting for {name}")
        elif self.silent:
            status.mergeSummary(silence_level, f"{name} silent for {self.age_s:.1f} s")
        if self.complaint:
            status.mergeSummary(WARN, f"{name}: {self.complaint}")
        status.add(f"{name}: rate [Hz]", f"{self.rate_hz:.1f}")
        status.add(f"{name}: received", str(self.received))
        status.add(f"{name}: rejected", str(self.rejected))


class Diagnostics:
    """Calls a node's `report(status)` a few times a second, in a thread of its own."""

    def __init__(self, report: Callable[[DiagnosticStatusWrapper], DiagnosticStatusWrapper], hardware_id: str) -> None:
        self._report = report
        self._updater = Updater()
        self._updater.setHardwareID(hardware_id)
        self._updater.add("state", self._judge)
        self._error: Optional[Exception] = None
        Periodic(self._update, PERIOD_S, "diagnostics")

    def _update(self) -> None:
        self._error = None
        self._updater.force_update()
        if self._error is not None:
            raise self._error

    def _judge(self, status: DiagnosticStatusWrapper) -> DiagnosticStatusWrapper:
        try:
            self._report(status)
        except Exception as error:  # silence would look as if the node had ended
            self._error = error
            status.summary(ERROR, f"the diagnostics fail: {type(error).__name__}: {error}")
        status.message = one_line(status.message)  # of several problems, and of what they quote
        return status
