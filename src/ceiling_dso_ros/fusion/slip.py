# SPDX-License-Identifier: BSD-3-Clause
"""Compares wheels and camera to detect slipping wheels and jumps of the visual scale."""

import math
from collections import deque
from dataclasses import dataclass
from typing import Deque, List, NamedTuple, Optional, Tuple

import numpy as np

from ceiling_dso_ros.dso.durations import seconds
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.config import FusionConfig
from ceiling_dso_ros.fusion.graph import Interval
from ceiling_dso_ros.fusion.visual import VisualMotion
from ceiling_dso_ros.fusion.wheel_motion import WheelMotion, WheelNoise

MOST_REPORTS = 10_000  # that are kept: a robot that slips every minute for a week
MOST_DEPTHS = 100  # tens of metres of a roof
DEPTH_SIGMA = 0.05  # change of the map's median depth within some keyframes, relative: girders, lamps and ducts
LONGEST_SLIP_M = 10.0  # of a steady slip: a wet patch or a ramp ends, a tyre that wears or a heavy load does not
CLEAR = 3.0  # logarithm of the odds at which the depths decide, twenty to one
LEAST_FACTOR = -0.99  # wheels that stand


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


class SteadyError(NamedTuple):
    """A distance that stays wrong by the same factor: from the interval that ends at node `start` on.

    Attributes:
        start: the node.
        of_scale: the scale is another since then; else both wheels slip steadily.
        doubt_m: how far the pose there may be wrong by what was believed until now.
    """

    start: int
    of_scale: bool
    doubt_m: float


class SlipMonitor:
    """Compares wheels and camera interval by interval.

    The turn needs no scale and is always compared, the distance once the scale is known. A distance that is wrong for
    some time is slip. One that stays wrong by the same factor, while the turns agree, is a jump of the visual scale or
    a steady slip of both wheels: if the scale jumps, the depth of the map changes by the factor too, since the ceiling
    stays where it is.

    Attributes:
        reports: the slips so far, of many only the newest; slips close in time are joined.
    """

    def __init__(self, config: FusionConfig, noise: WheelNoise) -> None:
        self._config = config
        self._noise = noise
        self._constants = noise.constants_covariance(with_radius=False)
        self._recent: Deque[Tuple[int, Disagreement]] = deque(maxlen=config.slip.jump_steps)
        self._depths: Deque[float] = deque(maxlen=MOST_DEPTHS)  # of the map at the ends of the newest intervals
        self._newest_m = 0.0  # way of the newest interval by the wheels
        self._agreed_m = 0.0  # way of the segment before the newest distances were wrong by one factor
        self._steady_m = 0.0  # and since then
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
        return _is_beyond(self._config.slip.gate, found, scale_known)

    def images_contradict(self, found: Disagreement, scale_known: bool) -> bool:
        """The same of a difference between two images, of which there are many more."""
        return _is_beyond(self._config.slip.image_gate, found, scale_known)

    def slips(self, interval: Interval, found: Disagreement, scale_known: bool) -> bool:
        """Whether the wheels slip between two keyframes; call it once for each interval, in order."""
        if not interval.continues:
            self._depths.clear()
            self._agreed_m = self._steady_m = 0.0
        self._depths.append(interval.depth)
        if self.beyond_gate(found, scale_known=False) or not scale_known:
            self._recent.clear()
        else:
            self._recent.append((interval.end, found))
        self._newest_m = abs(float(interval.wheels.pose[0]))
        slipping = self.beyond_gate(found, scale_known)
        if slipping:
            self.report(interval)
        return slipping

    def steady_error(self) -> Optional[SteadyError]:
        """A distance that has been wrong by one factor for `jump_steps` nodes, as many as that later; else None.

        The depth of the map tells whether the scale jumped. Where it does not tell, wheels slip more often than a scale
        jumps, but not for long: then their radius is another, or it was the scale. And if they disagree for longer than
        they agreed before, they rather slipped before, when the scale was found.
        """
        factor = self._steady_factor()
        if factor is None:
            self._agreed_m, self._steady_m = self._agreed_m + self._newest_m, 0.0
            return None
        self._steady_m += self._newest_m
        start, evidence = self._recent[0][0], self._jump_evidence(factor)
        slipped_before = self._steady_m > self._agreed_m
        too_long = evidence > -CLEAR and self._steady_m > LONGEST_SLIP_M
        if not (evidence > CLEAR or slipped_before or too_long):
            return SteadyError(start, of_scale=False, doubt_m=0.0)
        wrong_m = 0.0 if evidence > CLEAR else self._steady_m + (self._agreed_m if slipped_before else 0.0)
        self._recent.clear()
        self._agreed_m, self._steady_m = self._steady_m, 0.0
        return SteadyError(start, of_scale=True, doubt_m=abs(factor) * wrong_m)

    def _steady_factor(self) -> Optional[float]:
        """The factor, less 1, by which the newest distances are wrong in common; None if they are not."""
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
        return None if misfit > 4.0 * len(recent) else float(factor)

    def _jump_evidence(self, factor: float) -> float:
        """Logarithm of the odds, by the map's depths, of a scale that jumped by 1 + factor to wheels that slip.

        In a jump, the depth is divided by 1 + factor; else it changes as it always does under this roof.
        """
        steps = self._config.slip.jump_steps
        depths = np.log(list(self._depths))
        before, after = depths[-2 * steps : -steps], depths[-(steps // 2) :]
        if not np.isfinite(before).any() or not np.isfinite(after).any():
            return 0.0
        found, expected = np.nanmedian(before) - np.nanmedian(after), math.log1p(max(factor, LEAST_FACTOR))
        changes = np.abs(depths[steps:-steps] - depths[: -2 * steps])
        sigma = max(DEPTH_SIGMA, float(np.nanmedian(changes)) if np.isfinite(changes).any() else 0.0)
        return expected * (2.0 * found - expected) / (2.0 * sigma**2)

    def forget(self, start_ns: int) -> None:
        """Withdraw the reports since then: they were not slips."""
        kept = [report for report in self.reports if report.start_ns < start_ns]
        self.reports = [SlipReport(report.start_ns, min(report.end_ns, start_ns)) for report in kept]

    def report(self, interval: Interval) -> None:
        """Take note that the wheels slipped between two keyframes, the newest ones or some of those before."""
        start_ns, end_ns = interval.wheels.start_ns, interval.wheels.end_ns
        if self.reports and seconds(start_ns - self.reports[-1].end_ns) <= self._config.slip.report_gap_s:
            last = self.reports[-1]
            self.reports[-1] = SlipReport(min(last.start_ns, start_ns), max(last.end_ns, end_ns))
        else:
            self.reports.append(SlipReport(start_ns, end_ns))
            del self.reports[:-MOST_REPORTS]


def _is_beyond(gate: float, found: Disagreement, scale_known: bool) -> bool:
    turns_differ = found.turn_rad**2 > gate * found.turn_variance
    return turns_differ or (scale_known and found.forward_m**2 > gate * found.forward_variance)
