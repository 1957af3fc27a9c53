# SPDX-License-Identifier: BSD-3-Clause
"""Reduces the rate of images by their stamps alone, so that live and offline runs select the same images."""

import math
from typing import Optional

from ceiling_dso_ros.io.errors import InputError

AUTO = "auto"  # instead of a number: the rate follows the motion
SLOWEST_HZ = 1.0 / 3600.0  # nobody tracks one image an hour; below it, periods leave the range of integers
EARLY_SHARE, EARLY_NS = 0.25, 10_000_000  # how early an image may be because of jitter: share of a period, and maximum
BACKWARDS_PERIODS = 2.0  # a larger jump backwards means another run; a smaller one means images out of order


def require_frame_rate(frame_rate: float, name: str) -> None:
    """Require images a second that `FrameRateLimit` can select.

    Args:
        frame_rate: images a second; 0 for all.
        name: of the option or parameter and what follows it, for the message.

    Raises:
        InputError: it is none, in one line.
    """
    if frame_rate != 0.0 and not SLOWEST_HZ <= frame_rate < math.inf:
        raise InputError(f"{name}{frame_rate:g}: 0 for all images, or {SLOWEST_HZ:.1g} (one an hour) or more a second")


def parse_frame_rate(text: str, name: str) -> Optional[float]:
    """Images a second, 0 for all; None where they are to follow the motion.

    Args:
        text: a number, or AUTO.
        name: of the option or parameter and what follows it, for the message.

    Raises:
        InputError: it is neither, in one line.
    """
    if text == AUTO:
        return None
    try:
        frame_rate = float(text)
    except ValueError:
        raise InputError(f"{name}{text}: a number, 0 for all images, or {AUTO}") from None
    require_frame_rate(frame_rate, name)
    return frame_rate


class FrameRateLimit:
    """Selects images at about a given rate.

    The selected images are near the ticks of a clock with that rate. The clock starts with the first image, and again
    after a gap or when time goes back. So the mean rate is right also if the camera's rate is not a multiple of it, and
    no image of a slower camera is left out.

    Attributes:
        frame_rate: images a second; 0 lets all pass, see `require_frame_rate`. May be changed at any time.
    """

    def __init__(self, frame_rate: float = 0.0) -> None:
        self.frame_rate = frame_rate
        self._due_ns: Optional[int] = None  # of the next tick

    def passes(self, stamp_ns: int) -> bool:
        """Whether to use the image with this stamp, nanoseconds; call it once for each image, in order."""
        if self.frame_rate == 0.0:
            return True
        period_ns = round(1e9 / self.frame_rate)
        due_ns = self._due_ns
        if due_ns is None or not -(1.0 + BACKWARDS_PERIODS) * period_ns <= stamp_ns - due_ns <= period_ns:
            self._due_ns = stamp_ns + period_ns
            return True
        if stamp_ns - due_ns < -min(EARLY_SHARE * period_ns, EARLY_NS):
            return False
        self._due_ns = due_ns + period_ns
        return True
