# SPDX-License-Identifier: BSD-3-Clause
"""How late a reference is stamped, found from what depends neither on frames nor on the scale.

Within a short window a body covers a distance and turns by an angle. Both are the same in every world frame, the angle
also for every frame on the body, and the distance but for the scale. So with a signal x of the estimate and the same
signal y of the reference, and the offset d to be added to the stamps of the estimate,

    y(t + d) = s x(t) + b + noise.

The largest correlation gives d roughly, and the solution of sum z r = 0 gives it exactly, with the residual r and z the
part of s dx/dt that is linear in neither x nor 1. The slope of the estimate and not that of the reference, because the
noise of y in both r and z would draw d to those offsets at which interpolation smooths y most.

The standard deviation is that of the sum of z r over blocks of time: it holds for noise of any kind that is independent
from block to block. If distance and angle tell different offsets, as with a rolling shutter, it is larger.
"""

import math
from dataclasses import dataclass, replace
from typing import Any, Dict, Optional, Sequence, Tuple

import numpy as np
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.dso.durations import nanoseconds, seconds
from ceiling_dso_ros.evaluation.association import interpolate_poses
from ceiling_dso_ros.io.trajectory import Trajectory

LARGEST_S = 1.0  # clocks that differ by more are not synchronised at all
WINDOW_S = 0.2  # robots change their speed within a second; a shorter window has more noise
BLOCK_S = 2.0  # of the standard deviation, ten windows
FEWEST_BLOCKS = 4.0  # with changes of motion: the scatter of fewer says little
SIGMAS = 5.0  # of the correlation of signals that have nothing to do with each other
SIGNIFICANT_SIGMAS = 3.0
SIGNIFICANT_S = 0.002  # less is usual: a stamp may be that of the begin or the middle of an exposure
MOST_SAMPLES = 20_000  # evenly chosen from longer trajectories
OUTLIER = 3.0  # standard deviations: beyond it the influence of a residual becomes smaller
STEPS = 20


@dataclass(frozen=True)
class TimeOffset:
    """An offset of stamps.

    Attributes:
        value_s: seconds to be added to the stamps of the estimate; positive if the reference is late.
        sigma_s: its standard deviation.
        unknown: why the trajectories do not determine it; empty if they do.
    """

    value_s: float
    sigma_s: float
    unknown: str = ""

    @property
    def significant(self) -> bool:
        """Whether it is known, not just noise, and not so small that it does not matter."""
        return not self.unknown and abs(self.value_s) > max(SIGNIFICANT_SIGMAS * self.sigma_s, SIGNIFICANT_S)

    def numbers(self) -> Dict[str, Any]:
        """Types that JSON supports."""
        return {"unknown": self.unknown} if self.unknown else {"value_s": self.value_s, "sigma_s": self.sigma_s}

    def __str__(self) -> str:
        return self.unknown or f"{1e3 * self.value_s:+.1f} +- {1e3 * self.sigma_s:.1f} ms"


class _UnknownError(Exception):
    """Why the offset is not known."""


@dataclass(frozen=True)
class _Signal:
    """Values at increasing times; NaN where they are unknown."""

    times_s: np.ndarray
    values: np.ndarray

    def at(self, times_s: np.ndarray) -> np.ndarray:
        return np.interp(times_s, self.times_s, self.values, np.nan, np.nan)

    def slope(self, times_s: np.ndarray, step_s: float) -> np.ndarray:
        return (self.at(times_s + step_s) - self.at(times_s - step_s)) / (2.0 * step_s)


def estimate_time_offset(estimate: Trajectory, reference: Trajectory) -> TimeOffset:
    """The offset between two trajectories of one body, or of two that are rigidly connected."""
    try:
        return _estimate(estimate, reference)
    except _UnknownError as reason:
        return TimeOffset(math.nan, math.inf, str(reason))


def _estimate(estimate: Trajectory, reference: Trajectory) -> TimeOffset:
    if min(len(estimate), len(reference)) < 3:
        raise _UnknownError("there are too few poses")
    period_s = max(float(np.median(np.diff(each.times_s))) for each in (estimate, reference))
    window_s = max(WINDOW_S, 2.0 * period_s)
    begin_ns = int(estimate.stamps_ns[0])
    # A signal of the estimate beside that of the reference, each for the distance and for the angle.
    pairs = list(zip(*(_signals(each, begin_ns, window_s) for each in (estimate, reference))))
    times_s = estimate.times_s[:: -(-len(estimate) // MOST_SAMPLES)]
    rough_s = _most_similar(pairs, times_s, window_s)
    found = _refined(pairs, times_s, rough_s, window_s)
    return replace(found, sigma_s=found.sigma_s * _disagreement(pairs, times_s, rough_s, window_s))


def _disagreement(
    pairs: Sequence[Tuple[_Signal, _Signal]], times_s: np.ndarray, rough_s: float, window_s: float
) -> float:
    """By how much the offsets of the signals differ, in standard deviations, at least 1."""
    try:
        one, other = (_refined([pair], times_s, rough_s, window_s) for pair in pairs)
    except _UnknownError:  # one of them alone does not tell
        return 1.0
    sigma_s = math.hypot(one.sigma_s, other.sigma_s)
    return max(abs(one.value_s - other.value_s) / max(sigma_s, 1e-9), 1.0)


def _signals(trajectory: Trajectory, begin_ns: int, window_s: float) -> Tuple[_Signal, _Signal]:
    """Mean speed and mean angular speed in the window that begins at each pose; unknown where poses are missing in it.

    Few values that are much larger than all others, such as where tracking was lost, are limited.
    """
    stamps_ns, poses = trajectory.stamps_ns, trajectory.matrices()
    ends_ns = stamps_ns + nanoseconds(window_s)
    gaps = np.concatenate([[0], np.cumsum(np.diff(stamps_ns) > nanoseconds(window_s))])
    last = np.minimum(np.searchsorted(stamps_ns, ends_ns), len(stamps_ns) - 1)
    known = (ends_ns <= stamps_ns[-1]) & (gaps[last] == gaps)
    speed, turn_rate = np.full((2, len(stamps_ns)), np.nan)
    if known.any():
        ends = interpolate_poses(stamps_ns, poses, ends_ns[known])
        turned = np.transpose(poses[known, :3, :3], (0, 2, 1)) @ ends[:, :3, :3]
        speed[known] = _limited(np.linalg.norm(ends[:, :3, 3] - poses[known, :3, 3], axis=1) / window_s)
        turn_rate[known] = _limited(Rotation.from_matrix(turned).magnitude() / window_s)
    times_s = seconds(stamps_ns - begin_ns)
    return _Signal(times_s, speed), _Signal(times_s, turn_rate)


def _limited(values: np.ndarray) -> np.ndarray:
    return np.minimum(values, 2.0 * np.percentile(values, 99))


def _most_similar(pairs: Sequence[Tuple[_Signal, _Signal]], times_s: np.ndarray, window_s: float) -> float:
    """The offset at which the signals are most alike, to a tenth of the window."""
    step_s = 0.1 * window_s
    offsets_s = step_s * np.arange(-math.ceil(LARGEST_S / step_s), math.ceil(LARGEST_S / step_s) + 1)
    mine = [signal.at(times_s) for signal, _ in pairs]
    found = [
        [_correlation(x, its.at(times_s + offset_s)) for x, (_, its) in zip(mine, pairs)] for offset_s in offsets_s
    ]
    correlations, counts = np.moveaxis(np.array(found), 2, 0)  # (offsets, signals)
    if not counts.max() > 0:
        raise _UnknownError("there is no time in common without gaps")
    correlations[counts < 0.5 * counts.max()] = 0.0  # the ends alone are alike by chance
    best = int(np.argmin(np.log1p(-np.square(np.minimum(correlations, 0.999999))).sum(axis=1)))
    covered_s = counts[best].max() * float(np.median(np.diff(times_s)))
    if not correlations[best].max() > SIGMAS / math.sqrt(max(covered_s / window_s, 1.0)):
        raise _UnknownError("speed and yaw rate hardly change, or are not those of the reference")
    if best in (0, len(offsets_s) - 1):
        raise _UnknownError(f"it may be larger than {LARGEST_S:g} s")
    return float(offsets_s[best])


def _correlation(x: np.ndarray, y: np.ndarray) -> Tuple[float, int]:
    """Of the values that both have, at least 0, and their number."""
    both = np.isfinite(x) & np.isfinite(y)
    count = int(np.count_nonzero(both))
    if count < 3:
        return 0.0, 0
    x, y = x[both] - x[both].mean(), y[both] - y[both].mean()
    scale = math.sqrt(float(x @ x) * float(y @ y))
    return (max(float(x @ y) / scale, 0.0) if scale > 0.0 else 0.0), count


def _refined(
    pairs: Sequence[Tuple[_Signal, _Signal]], times_s: np.ndarray, rough_s: float, window_s: float
) -> TimeOffset:
    """Solve sum z r = 0 of both signals, weighted by their noise, beginning near the solution."""
    _, block = np.unique(np.floor(times_s / max(BLOCK_S, 10.0 * window_s)), return_inverse=True)
    offset_s = rough_s
    for _ in range(STEPS):
        score, information = np.zeros((2, block.max() + 1))
        for mine, its in pairs:
            terms = _terms(mine, its, times_s, offset_s, 0.25 * window_s)
            if terms is not None:
                used, of_score, of_information = terms
                score += np.bincount(block[used], of_score, len(score))
                information += np.bincount(block[used], of_information, len(score))
        if not information.sum() > 0.0:
            break
        step_s = -score.sum() / information.sum()
        offset_s += step_s
        if abs(offset_s - rough_s) > window_s:
            break
        if abs(step_s) < 1e-7:
            blocks = information.sum() ** 2 / np.square(information).sum()  # of equal information
            if blocks < FEWEST_BLOCKS:
                break
            few = blocks / (blocks - 2.0)  # the scatter of few blocks is itself uncertain
            return TimeOffset(offset_s, float(math.sqrt(few * np.square(score).sum()) / information.sum()))
    raise _UnknownError("there are too few changes of speed or yaw rate")


def _terms(
    mine: _Signal, its: _Signal, times_s: np.ndarray, offset_s: float, step_s: float
) -> Optional[Tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """The products z r, and their derivatives by the offset, over the variance of r.

    Returns:
        Which times are used, (N,) bool, and the two values for each of them; None if they tell nothing.
    """
    x, y = mine.at(times_s), its.at(times_s + offset_s)
    slope_x, slope_y = mine.slope(times_s, step_s), its.slope(times_s + offset_s, step_s)
    used = np.isfinite(x + y + slope_x + slope_y)
    x, y, slope_x, slope_y = x[used], y[used], slope_x[used], slope_y[used]
    if len(x) < 10 or np.ptp(x) == 0.0:
        return None
    weights = np.ones(len(x))
    for _ in range(3):
        A = np.column_stack([x, np.ones(len(x))])
        to_fit = np.linalg.pinv(A * weights[:, None] ** 0.5) * weights**0.5
        fit = to_fit @ y
        residual = y - A @ fit
        z = fit[0] * (slope_x - A @ (to_fit @ slope_x))
        told = weights * np.square(z)  # by z, because a robot that stands for long has hardly any noise then
        sigma = math.sqrt(float(told @ np.square(residual)) / max(float(told.sum()), 1e-300)) + 1e-12
        weights = 1.0 / (1.0 + np.square(residual / (OUTLIER * sigma)))
    scaled = weights * z / sigma**2
    return used, scaled * residual, scaled * slope_y
