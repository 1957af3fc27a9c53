# SPDX-License-Identifier: BSD-3-Clause
"""What is doubtful while a new map contradicts the wheels, until it is known which of them was wrong."""

import math
from dataclasses import replace
from typing import List

import numpy as np

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.graph import Interval, WindowGraph
from ceiling_dso_ros.fusion.slip import SlipMonitor


class Doubts:
    """Intervals of the newest segment in which camera and wheels contradict each other before its scale is known.

    Args:
        graph: the wheels' noise in its intervals covers the doubt.
        monitor: hears of wheels that were wrong.
    """

    def __init__(self, graph: WindowGraph, monitor: SlipMonitor) -> None:
        self._graph, self._monitor = graph, monitor
        self._intervals: List[Interval] = []  # as the camera tells
        self._without_camera = 0  # intervals so far in which it may be frozen

    def __bool__(self) -> bool:
        """Whether there are any."""
        return bool(self._intervals)

    def forget(self) -> None:
        """Another segment begins: what was doubtful remains so."""
        self._intervals = []

    def refused(self, interval: Interval, scale: float) -> Interval:
        """The interval by the wheels alone, with the difference from the camera's motion as their error.

        Args:
            interval: with a motion of the camera.
            scale: metres per unit.
        """
        self._intervals.append(interval)
        doubt = _adding_up(len(self._intervals)) * _difference(interval, scale)
        return replace(interval, visual=None, continues=False, wheels_slip=True, doubt=doubt)

    def stood_or_drove(self, interval: Interval, scale: float) -> Interval:
        """The interval by the wheels alone: the camera was frozen, or the robot stood while its wheels turned.

        Args:
            interval: with a motion of the camera.
            scale: metres per unit.
        """
        self._without_camera += 1
        doubt = _adding_up(self._without_camera) * _difference(interval, scale)
        return replace(interval, visual=None, wheels_slip=False, doubt=doubt)

    def camera_is_used(self) -> None:
        """It is no longer doubted: what was doubtful remains so."""
        self._without_camera = 0

    def resolve(self, scale: float) -> None:
        """The map has come to agree with the wheels, and is the same as before: the wheels slipped, or were stuck."""
        for interval in self._intervals:
            as_seen = {"visual": interval.visual, "continues": interval.continues}
            self._graph.revise(interval.end, wheels_slip=True, doubt=None, **as_seen)
            self._monitor.report(interval)
        self.suspect_before(self._intervals[0], scale)
        self._intervals = []

    def suspect_before(self, slipping: Interval, scale: float) -> None:
        """Where wheels slipped when the camera saw again, they may have done so before, while it was blind.

        Args:
            slipping: with a motion of the camera.
            scale: metres per unit.
        """
        blind = next((each for each in self._graph.intervals if each.end == slipping.end - 1), None)
        if blind is None or blind.visual is not None or blind.doubt is not None:
            return
        per_second = _difference(slipping, scale) / slipping.wheels.duration_s
        self._graph.revise(blind.end, wheels_slip=True, doubt=per_second * blind.wheels.duration_s)


def _adding_up(number: int) -> float:
    """Of the error in the n-th of intervals with the same error, so that the errors add up, and not their variances."""
    return math.sqrt(2 * number - 1)


def _difference(interval: Interval, scale: float) -> np.ndarray:
    """(3,) motion by the camera minus that by the wheels."""
    assert interval.visual is not None
    seen, rolled = interval.visual.base_motion(scale), interval.wheels.pose
    return np.array([*(seen[:2] - rolled[:2]), planar.wrap(seen[2] - rolled[2])])
