# SPDX-License-Identifier: BSD-3-Clause
"""Medians, their spread, and how sure a difference is."""

from typing import NamedTuple, Optional, Sequence

import numpy as np
from scipy.stats import bootstrap

RESAMPLES = 2000
LEAST_PAIRS = 3  # for an interval: the interval of two values is these values


class Change(NamedTuple):
    """A value over that of another version or setting.

    Attributes:
        ratio: the median over all pairs.
        low, high: bootstrap interval of it; None of too few pairs.
        pairs: their number.
    """

    ratio: float
    low: Optional[float]
    high: Optional[float]
    pairs: int

    def __str__(self) -> str:
        """With the interval in brackets."""
        interval = "" if self.low is None or self.high is None else f" [{self.low:.3f}, {self.high:.3f}]"
        return f"{self.ratio:.3f}{interval}"


def change_of(before: Sequence[float], after: Sequence[float], confidence: float = 0.95) -> Optional[Change]:
    """The change of positive values that belong together one by one; None without any.

    The interval is that of a percentile bootstrap of the median of the logarithms, always with the same random numbers.
    """
    pairs = [(b, a) for b, a in zip(before, after) if b > 0.0 and a > 0.0]
    if not pairs:
        return None
    logs = np.diff(np.log(np.array(pairs)), axis=1)[:, 0]
    ratio = float(np.exp(np.median(logs)))
    if len(logs) < LEAST_PAIRS:
        return Change(ratio, None, None, len(logs))
    if np.ptp(logs) == 0.0:
        return Change(ratio, ratio, ratio, len(logs))
    low, high = bootstrap(
        (logs,), np.median, n_resamples=RESAMPLES, confidence_level=confidence, method="percentile", random_state=0
    ).confidence_interval
    return Change(ratio, float(np.exp(low)), float(np.exp(high)), len(logs))


def spread_of(values: Sequence[float], digits: int = 3) -> str:
    """Median, and the smallest and largest value where there are several; a dash without any."""
    if not len(values):
        return "-"
    median = f"{np.median(values):.{digits}g}"
    return median if len(values) == 1 else f"{median} [{min(values):.{digits}g}, {max(values):.{digits}g}]"
