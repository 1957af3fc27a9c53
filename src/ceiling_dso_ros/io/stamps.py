# SPDX-License-Identifier: BSD-3-Clause
"""Time stamps: integer nanoseconds, as text and as ROS writes them.

Never floats: at today's epoch they are 0.2 us apart.
"""

from decimal import Decimal, InvalidOperation
from typing import Tuple

NANOSECONDS = 10**9
LATEST_NS = 2**63 - 1  # what an int64 holds


def parse_stamp_ns(text: str) -> int:
    """Exact nanoseconds of a decimal number of seconds; digits beyond the ninth are rounded.

    Raises:
        ValueError: text is not a finite, non-negative decimal number, or one beyond the year 2262.
    """
    try:
        stamp_ns = int((Decimal(text) * NANOSECONDS).to_integral_value())
    except (InvalidOperation, OverflowError, ValueError):
        raise ValueError(f"'{text}' is not a time in seconds") from None
    if stamp_ns < 0:
        raise ValueError(f"the time {text} is negative")
    if stamp_ns > LATEST_NS:
        raise ValueError(f"the time {text} is beyond the year 2262; stamps are seconds")
    return stamp_ns


def format_stamp(stamp_ns: int) -> str:
    """Nanoseconds as a decimal number of seconds with nine digits, the inverse of `parse_stamp_ns`."""
    return f"{stamp_ns // NANOSECONDS}.{stamp_ns % NANOSECONDS:09d}"


def stamp_from_parts(seconds: int, nanoseconds: int) -> int:
    """Nanoseconds of a ROS time, which has whole seconds and the nanoseconds beyond them."""
    return seconds * NANOSECONDS + nanoseconds


def parts_of_stamp(stamp_ns: int) -> Tuple[int, int]:
    """Whole seconds and the nanoseconds beyond them, the inverse of `stamp_from_parts`."""
    return divmod(stamp_ns, NANOSECONDS)
