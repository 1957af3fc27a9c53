# SPDX-License-Identifier: BSD-3-Clause
"""Compares wheels and camera to detect slipping wheels and jumps of the visual scale."""

from collections import deque
from dataclasses import dataclass
from typing import Deque, List, Optional, Tuple

import numpy as np

from ceiling_dso_ros.dso.durations import seconds
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.config import FusionConfig
from ceiling_dso_ros.fusion.graph import Interval
from ceiling_dso_ros.fusion.visual import VisualMotion
from ceiling_dso_ros.fusion.wheel_motion import WheelMotion, WheelNoise

MOST_REPORTS = 10_000  # that are kept: a robot that slips every minute for a week


@dataclass(frozen=True)
class SlipReport:
    """A time during which the wheels slipped: stamps in nanoseconds."""

    start_ns: int
    end_ns: int


@dataclass(frozen=True)
class Disagreement:
    """Wheels minus camera over one interval.

    Attributes:
        turn_rad, forward_m: the differences.
        turn_variance, forward_variance: their expected variances, rad^2 and m^2.
        distance_m: forward distance of the base by the camera.
    """

    turn_rad: float
    forward_m: float
    turn_variance: float
    forward_variance: float
    distance_m: float


class SlipMonitor:
    """Compares wheels and camera interval by interval.

    The turn needs no scale and is always compared, the distance once the scale is known. A distance that is wrong for
    some time is slip. One that stays wrong by the same factor, while the turns agree, is a jump of the visual scale.

    Attributes:
        reports: the slips so far, of many only the newest; slips close in time are joined.
    """

    def __init__(self, config: FusionConfig, noise: WheelNoise) -> None:
        self._config = config
        self._noise = noise
        self._constants = noise.constants_covariance(with_radius=False)
        self._recent: Deque[Tuple[int, Disagreement]] = deque(maxlen=config.slip.jump_steps)
        self.reports: List[SlipReport] = []

    def compare(self, wheels: WheelMotion, visual: VisualMotion, scale: float, scale_sigma: float) -> Disagreement:
        """The difference over an interval; metres per unit with their relative standard deviation."""
        config = self._config.visual
        seen = visual.base_motion(scale)
        covariance, of_camera = self._noise.covariance(wheels, self._constants), visual.noise(config)
        from_scale = scale_sigma * scale * np.hypot(*visual.shift)
        return Disagreement(
            planar.wrap(wheels.pose[2] - seen[2]),
            float(wheels.pose[0] - seen[0]),
            float(covariance[2, 2] + of_camera[2, 2]),
            float(covariance[0, 0] + scale**2 * of_camera[0, 0] + from_scale**2),
            float(seen[0]),
        )

    def beyond_gate(self, found: Disagreement, scale_known: bool) -> bool:
        """Whether a difference exceeds its expected variance; without a scale only the turn is tested."""
        return self._turn_beyond(found) or (
            scale_known and found.forward_m**2 > self._config.slip.gate * found.forward_variance
        )

    def slips(self, interval: Interval, found: Disagreement, scale_known: bool) -> bool:
        """Whether the wheels slip between two keyframes; call it once for each interval, in order."""
        if self._turn_beyond(found) or not scale_known:
            self._recent.clear()
        else:
            self._recent.append((interval.end, found))
        slipping = self.beyond_gate(found, scale_known)
        if slipping:
            self.report(interval)
        return slipping

    def scale_jump(self) -> Optional[int]:
        """The node at which the visual scale jumped, found `jump_steps` nodes later; None when it did not."""
        if len(self._recent) < self._config.slip.jump_steps:
            return None
        recent = [found for _, found in self._recent]
        forward = np.array([found.forward_m for found in recent])
        distance = np.array([found.distance_m for found in recent])
        variance = np.array([found.forward_variance for found in recent])
        if forward.sum() ** 2 <= self._config.slip.gate * variance.sum():
            return None
        factor = (forward * distance / variance).sum() / (distance**2 / variance).sum()
        misfit = ((forward - factor * distance) ** 2 / variance).sum()
        if misfit > 4.0 * len(recent):
            return None
        start = self._recent[0][0]
        self._recent.clear()
        return start

    def _turn_beyond(self, found: Disagreement) -> bool:
        return found.turn_rad**2 > self._config.slip.gate * found.turn_variance

    def forget(self, start_ns: int) -> None:
        """Withdraw the reports since then: they were not slips."""
        kept = [report for report in self.reports if report.start_ns < start_ns]
        self.reports = [SlipReport(report.start_ns, min(report.end_ns, start_ns)) for report in kept]

    def report(self, interval: Interval) -> None:
        """Take note that the wheels slipped between two keyframes."""
        start_ns, end_ns = interval.wheels.start_ns, interval.wheels.end_ns
        if self.reports and seconds(start_ns - self.reports[-1].end_ns) <= self._config.slip.report_gap_s:
            self.reports[-1] = SlipReport(self.reports[-1].start_ns, end_ns)
        else:
            self.reports.append(SlipReport(start_ns, end_ns))
            del self.reports[:-MOST_REPORTS]
