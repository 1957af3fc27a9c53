# SPDX-License-Identifier: BSD-3-Clause
"""Plays recorded wheel samples one by one, as the nodes would receive them."""

from typing import Iterator, Optional

from ceiling_dso_ros.fusion.estimator import FusionEstimator
from ceiling_dso_ros.fusion.state import FusedState
from ceiling_dso_ros.fusion.wheel import WheelOdometry, WheelStep
from ceiling_dso_ros.io.recording import WheelSamples, WheelUnit
from ceiling_dso_ros.io.stamps import LATEST_NS


class WheelPlayback:
    """Plays the wheels of a recording into the fusion."""

    def __init__(self, wheels: WheelSamples, estimator: FusionEstimator) -> None:
        self._add = estimator.add_wheel_ticks if wheels.unit is WheelUnit.TICKS else estimator.add_wheel_angles
        self._samples = list(wheels)
        self._next = 0

    def until(self, stamp_ns: int = LATEST_NS) -> Iterator[FusedState]:
        """Play the samples up to a stamp, nanoseconds, by default all; yields the fusion's output for each."""
        while self._next < len(self._samples) and self._samples[self._next][0] <= stamp_ns:
            sample = self._samples[self._next]
            self._next += 1
            state: Optional[FusedState] = self._add(*sample)
            if state is not None:
                yield state


def wheel_steps(wheels: WheelSamples, odometry: WheelOdometry) -> Iterator[WheelStep]:
    """The steps of dead reckoning between the samples."""
    add = odometry.add_ticks if wheels.unit is WheelUnit.TICKS else odometry.add_angles
    for sample in wheels:
        step = add(*sample)
        if step is not None:
            yield step
