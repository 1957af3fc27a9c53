# SPDX-License-Identifier: BSD-3-Clause
"""Contradictions between camera and wheels that are taken back: an image was tracked wrongly, and no wheel slipped."""

from collections import deque
from functools import reduce
from typing import Deque, List

import numpy as np

from ceiling_dso_ros.dso.durations import seconds
from ceiling_dso_ros.fusion.graph import Interval
from ceiling_dso_ros.fusion.slip import SlipMonitor

LONGEST_S = 2.0  # over a longer way the wheels' own noise hides what they slipped


class TakenBack:
    """The newest intervals of a segment, since the camera began to contradict the wheels.

    What wheels have slipped stays between them and the camera. A torn image, or a keyframe made of one, is followed by
    one that leads back to where the wheels say: from before the one to after the other they agree.

    Args:
        monitor: compares them.
    """

    def __init__(self, monitor: SlipMonitor) -> None:
        self._monitor = monitor
        self._intervals: Deque[Interval] = deque()

    def see(self, newest: Interval, scale: float, scale_sigma: float) -> List[Interval]:
        """The slips that the newest interval takes back, itself included; none if it does not.

        Args:
            newest: as it was judged, call it once for each, in order.
            scale: metres per unit, known.
            scale_sigma: of its logarithm.
        """
        if newest.visual is None or not newest.continues:
            self._intervals.clear()
            return []
        self._intervals.append(newest)
        while not (self._intervals[0].wheels_slip and self._since(self._intervals[0]) <= LONGEST_S):
            self._intervals.popleft()
            if not self._intervals:
                return []
        if not newest.wheels_slip:
            return []
        for first in reversed(range(len(self._intervals) - 1)):
            run = list(self._intervals)[first:]
            if run[0].wheels_slip and self._agree(run, scale, scale_sigma):
                self._intervals.clear()
                return [interval for interval in run if interval.wheels_slip]
        return []

    def _since(self, first: Interval) -> float:
        return seconds(self._intervals[-1].wheels.end_ns - first.wheels.start_ns)

    def _agree(self, run: List[Interval], scale: float, scale_sigma: float) -> bool:
        """Whether wheels and camera agree over all of the intervals together."""
        wheels = reduce(lambda motion, further: motion.then(further), [interval.wheels for interval in run])
        seen = [interval.visual for interval in run if interval.visual is not None]
        visual = reduce(lambda motion, further: motion.then(further), seen)
        found = self._monitor.compare(wheels, visual, scale, scale_sigma)
        return not self._monitor.beyond_gate(found, scale_known=True) and self._leads_back(run, scale, scale_sigma)

    def _leads_back(self, run: List[Interval], scale: float, scale_sigma: float) -> bool:
        """Whether the last contradiction is opposed to the first: a wide gate alone says little."""
        first, last = (
            self._monitor.compare(interval.wheels, interval.visual, scale, scale_sigma)
            for interval in (run[0], run[-1])
            if interval.visual is not None
        )
        turns = first.turn_rad * last.turn_rad / np.sqrt(first.turn_variance * last.turn_variance)
        ways = first.forward_m * last.forward_m / np.sqrt(first.forward_variance * last.forward_variance)
        return bool(turns + ways < 0.0)
