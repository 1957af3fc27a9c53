# SPDX-License-Identifier: BSD-3-Clause
"""Time stamps: integer nanoseconds, as text and as ROS writes them.

Never floats: at today's epoch they are 0.2 us apart.
"""

from bisect import bisect_left
from decimal import Decimal, InvalidOperation
from typing import List, Sequence, Tuple

import numpy as np

NANOSECONDS = 10**9
LATEST_NS = 2**63 - 1  # what an int64 holds
LATEST_S = Decimal(LATEST_NS) / NANOSECONDS
# From one stamp to the next: in seconds more than a day, in nanoseconds a rate of 10 kHz.
UNIT_STEP = 100_000


def parse_stamp(text: str) -> Decimal:
    """A stamp of a text file as it is written; `stamps_in_ns` tells seconds from nanoseconds.

    Raises:
        ValueError: text is not a finite, non-negative decimal number, or one that is too large.
    """
    try:
        number = Decimal(text)
    except (InvalidOperation, ValueError):
        number = Decimal("nan")
    if not number.is_finite():
        raise ValueError(f"'{text}' is not a time in seconds")
    if number < 0:
        raise ValueError(f"the time {text} is negative")
    if number > LATEST_NS or (number > LATEST_S and number != number.to_integral_value()):
        raise ValueError(f"the time {text} is beyond the year 2262; stamps are seconds, or whole nanoseconds")
    return number


def stamps_in_ns(numbers: Sequence[Decimal]) -> List[int]:
    """Exact nanoseconds of the stamps of one file, which are seconds or nanoseconds.

    Nanoseconds are recognised by their size: as seconds they would be beyond the year 2262, or more than a day apart.
    Of seconds, digits beyond the ninth are rounded.

    Args:
        numbers: as `parse_stamp` gives them, in the order of the file.

    Raises:
        ValueError: they are neither, because as nanoseconds they would be too near to each other.
    """
    are_ns = [number > LATEST_S for number in numbers]
    if all(number.as_tuple().exponent >= 0 for number in numbers):  # type: ignore[operator]  # they are finite
        step = _median_step([int(number) for number in numbers])
        if any(are_ns) and 0 < step < UNIT_STEP:
            raise ValueError(f"stamps that are {step:.0f} apart are neither seconds nor nanoseconds")
        if any(are_ns) or step >= UNIT_STEP:
            are_ns = [True] * len(numbers)  # the clock of a robot may begin with zero
    units = [1 if is_ns else NANOSECONDS for is_ns in are_ns]
    return [int((number * unit).to_integral_value()) for number, unit in zip(numbers, units)]


def parse_stamp_ns(text: str) -> int:
    """Exact nanoseconds of a single stamp; see `parse_stamp` and `stamps_in_ns`."""
    return stamps_in_ns([parse_stamp(text)])[0]


def format_stamp(stamp_ns: int) -> str:
    """Nanoseconds as a decimal number of seconds with nine digits, the inverse of `parse_stamp_ns`."""
    return f"{stamp_ns // NANOSECONDS}.{stamp_ns % NANOSECONDS:09d}"


def stamp_from_parts(seconds: int, nanoseconds: int) -> int:
    """Nanoseconds of a ROS time, which has whole seconds and the nanoseconds beyond them."""
    return seconds * NANOSECONDS + nanoseconds


def parts_of_stamp(stamp_ns: int) -> Tuple[int, int]:
    """Whole seconds and the nanoseconds beyond them, the inverse of `stamp_from_parts`."""
    return divmod(stamp_ns, NANOSECONDS)


def longest_increasing(stamps_ns: Sequence[int]) -> List[int]:
    """What to keep of stamps of which some are wrong: the indices of the longest part that increases.

    So a single stamp that is far too late costs itself, not all that follow. Of equal stamps the first is kept.
    """
    tails: List[int] = []  # the smallest stamp that a part of each length can end with, its index, and that before it
    ends: List[int] = []
    before: List[int] = []
    for index, stamp_ns in enumerate(stamps_ns):
        length = bisect_left(tails, stamp_ns)
        before.append(ends[length - 1] if length else -1)
        if length == len(tails):
            tails.append(stamp_ns)
            ends.append(index)
        elif stamp_ns < tails[length]:
            tails[length], ends[length] = stamp_ns, index
    kept = ends[-1:]
    while kept and before[kept[-1]] >= 0:
        kept.append(before[kept[-1]])
    return kept[::-1]


def was_set_back(stamps_ns: np.ndarray) -> bool:
    """Whether the clock of (n,) int64 stamps was set back: two in a row lie before three that came before them.

    A single stamp that is too late or too early, or two that changed places, are no such clock.
    """
    earlier = np.minimum.reduce([stamps_ns[:-4], stamps_ns[1:-3], stamps_ns[2:-2]])
    return bool((np.maximum(stamps_ns[3:-1], stamps_ns[4:]) < earlier).any())


def _median_step(numbers: Sequence[int]) -> float:
    """Median difference of consecutive numbers that differ; 0 if none do."""
    steps = np.abs(np.diff(np.array(numbers, np.int64)))
    steps = steps[steps > 0]
    return float(np.median(steps)) if len(steps) else 0.0
