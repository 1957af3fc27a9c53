# SPDX-License-Identifier: BSD-3-Clause
"""Durations: stamps are integer nanoseconds, and only their differences become seconds."""

from typing import TypeVar

import numpy as np

Duration = TypeVar("Duration", float, np.ndarray)

NANOSECONDS = 10**9
LONG_AGO_NS = -(2**62)  # 146 years before 1970: earlier than any stamp


def seconds(duration_ns: Duration) -> Duration:
    """A difference of two stamps in seconds, or an array of them; the float nearest to each."""
    return duration_ns / NANOSECONDS


def nanoseconds(duration_s: float) -> int:
    """A duration given in seconds as the nearest number of nanoseconds, to be added to stamps."""
    return round(duration_s * NANOSECONDS)
