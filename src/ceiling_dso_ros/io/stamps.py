"""Time stamps: integer nanoseconds wherever they are read or written, seconds for computing.

A folder and a bag of the same recording hold the same nanoseconds, so they give the same floats.
"""

from decimal import Decimal, InvalidOperation

NANOSECONDS = 10**9


def parse_stamp_ns(text: str) -> int:
    """Exact nanoseconds of a decimal number of seconds; digits beyond the ninth are rounded.

    Raises:
        ValueError: text is not a finite, non-negative decimal number.
    """
    try:
        stamp_ns = int((Decimal(text) * NANOSECONDS).to_integral_value())
    except (InvalidOperation, OverflowError, ValueError):
        raise ValueError(f"'{text}' is not a time in seconds") from None
    if stamp_ns < 0:
        raise ValueError(f"the time {text} is negative")
    return stamp_ns


def seconds(stamp_ns: int) -> float:
    """Nanoseconds as the nearest float of seconds: the one rounding rule of the package."""
    return int(stamp_ns) / NANOSECONDS  # of integers: dividing by 1e9 would round twice


def format_stamp(stamp_ns: int) -> str:
    """Nanoseconds as a decimal number of seconds with nine digits, the inverse of `parse_stamp_ns`."""
    return f"{stamp_ns // NANOSECONDS}.{stamp_ns % NANOSECONDS:09d}"
