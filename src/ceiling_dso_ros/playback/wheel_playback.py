# SPDX-License-Identifier: BSD-3-Clause
"""Plays recorded wheel samples one by one, as the nodes would receive them."""

from typing import Callable, Dict, Iterator, Optional

from ceiling_dso_ros.fusion.estimator import FusionEstimator
from ceiling_dso_ros.fusion.state import FusedState
from ceiling_dso_ros.fusion.wheel import WheelOdometry
from ceiling_dso_ros.fusion.wheel_motion import WheelStep
from ceiling_dso_ros.io.recording import WheelSamples, WheelUnit
from ceiling_dso_ros.io.stamps import LATEST_NS
from ceiling_dso_ros.io.warning_log import ignore_warning


class WheelPlayback:
    """Plays the wheels of a recording into the fusion."""

    def __init__(
        self, wheels: WheelSamples, estimator: FusionEstimator, warn: Callable[[str], None] = ignore_warning
    ) -> None:
        """Begin; warn is told what is wrong with a sample."""
        self._estimator, self._warn = estimator, warn
        add: Dict[WheelUnit, Callable[..., Optional[FusedState]]] = {
            WheelUnit.TICKS: estimator.add_wheel_ticks,
            WheelUnit.RADIANS: estimator.add_wheel_angles,
            WheelUnit.POSES: estimator.add_wheel_odometry,
        }
        self._add = add[wheels.unit]
        self._samples = list(wheels)
        self._next = 0

    def until(self, stamp_ns: int = LATEST_NS) -> Iterator[FusedState]:
        """Play the samples up to a stamp, nanoseconds, by default all; yields the fusion's output for each."""
        while self._next < len(self._samples) and self._samples[self._next][0] <= stamp_ns:
            sample = self._samples[self._next]
            self._next += 1
            state = self._add(*sample)
            if self._estimator.wheels.message:
                self._warn(self._estimator.wheels.message)
            if state is not None:
                yield state


def wheel_steps(wheels: WheelSamples, odometry: WheelOdometry) -> Iterator[WheelStep]:
    """The steps of dead reckoning between the samples."""
    add: Dict[WheelUnit, Callable[..., Optional[WheelStep]]] = {
        WheelUnit.TICKS: odometry.add_ticks,
        WheelUnit.RADIANS: odometry.add_angles,
        WheelUnit.POSES: odometry.add_pose,
    }
    for sample in wheels:
        step = add[wheels.unit](*sample)
        if step is not None:
            yield step
