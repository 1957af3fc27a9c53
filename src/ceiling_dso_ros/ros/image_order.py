# SPDX-License-Identifier: BSD-3-Clause
"""Which images fusion_node may use: those of the present run, in order, at the wheels' time."""

import time
from collections import deque
from statistics import median_low
from typing import Callable, Deque, Optional

from ceiling_dso_ros.dso.durations import seconds
from ceiling_dso_ros.ros.data_clock import BACKWARDS_NS

CAMERA_AHEAD_NS = 10**9  # right after a restart, images this far ahead of the wheels belong to the run before
SWAPPED = 1.5  # intervals between images: two that changed places go back by one, a clock that was set by more
FIRST_INTERVAL_NS, LONGEST_INTERVAL_NS = 133_000_000, 10**9
DELAYS = 300  # of the last images that were used: ten seconds, so that some with wrong stamps do not count
AGREEING = 3  # images in a row, until the clocks agree again: one may come early by chance


class ImageOrder:
    """Judges stamps of images, which are on the wheels' clock, nanoseconds."""

    def __init__(self, is_simulated: bool, monotonic_s: Callable[[], float] = time.monotonic) -> None:
        """Begin a run; is_simulated: the clock is never set, but a bag may be played again."""
        self._is_simulated = is_simulated
        self._monotonic_s = monotonic_s
        self.reset()

    def reset(self) -> None:
        """Begin a new run."""
        self._wheels_heard_s = 0.0
        self._apart_s = 0.0
        self._last_ns: Optional[int] = None
        self._interval_ns = FIRST_INTERVAL_NS
        self._delays_ns: Deque[int] = deque([0], maxlen=DELAYS)  # by which images were behind the wheels
        self._set_back_ns = 0  # by which the camera's clock seems to have been set back since then, and not the wheels'
        self._agreeing = 0
        self._in_order = True  # the last image was later than the one before
        self._may_be_old = True

    def heard_wheels(self) -> None:
        """A wheel sample has arrived."""
        self._wheels_heard_s = self._monotonic_s()

    @property
    def apart(self) -> str:
        """That images and wheels are on two clocks, in words; empty while they seem to be on one."""
        if self.camera_set_back:
            return (
                f"the clock of the images was set back by {seconds(self._set_back_ns):.1f} s, that of the wheels was "
                "not: images are not used until the two agree again"
            )
        if abs(self._apart_s) <= seconds(CAMERA_AHEAD_NS):
            return ""
        order = "after" if self._apart_s > 0.0 else "before"
        late = "the wheels" if self._apart_s > 0.0 else "images"
        apart = f"{abs(self._apart_s):.1f} s {order} those of the wheels"
        return f"stamps of images are {apart}: two clocks, or {late} come late"

    @property
    def camera_set_back(self) -> bool:
        """The clock of the images was set back, and that of the wheels was not, so that images are not used."""
        return self._set_back_ns > 0

    def is_usable(self, stamp_ns: int, wheels_ns: Optional[int], complain: Callable[[str], None]) -> bool:
        """Whether to use an image.

        Args:
            stamp_ns: of the image.
            wheels_ns: of the newest wheel sample; None before the first.
            complain: takes what is wrong with an image of this run.
        """
        # Where the clock has been set ahead, images may come before the wheels tell of it: these are not silent.
        silence_s = self._monotonic_s() - self._wheels_heard_s
        wheels_are_silent = silence_s >= seconds(BACKWARDS_NS)
        self._apart_s = 0.0 if wheels_ns is None or wheels_are_silent else seconds(stamp_ns - wheels_ns)
        if wheels_ns is None or (self._may_be_old and stamp_ns > wheels_ns + CAMERA_AHEAD_NS):
            return False
        self._may_be_old = False
        if not self._is_simulated and stamp_ns > wheels_ns + BACKWARDS_NS and not wheels_are_silent:
            complain("an image that is far ahead of the wheels")
            return False
        if not self._agrees(stamp_ns, wheels_ns):
            complain("an image by a clock that was set back, other than that of the wheels")
            return False
        # Where the clock has been set back, images may come before the wheels tell by how much.
        if self._last_ns is not None and stamp_ns <= self._last_ns <= wheels_ns + CAMERA_AHEAD_NS:
            complain("an image that is not later than the last one")
            self._in_order = False
            return False
        if self._last_ns is not None:
            self._interval_ns = min(abs(stamp_ns - self._last_ns), LONGEST_INTERVAL_NS)
        self._last_ns, self._in_order = stamp_ns, True
        self._delays_ns.append(wheels_ns - stamp_ns)
        return True

    def _agrees(self, stamp_ns: int, wheels_ns: int) -> bool:
        """Whether an image has the clock of the images before.

        A camera whose clock is set back seems to be late all at once, and its stamps go back. Images that are really
        late still come in the order of their stamps. If the wheels' clock has been set, too, they soon agree again.
        """
        # Single images may have been late, and images that are ahead of the wheels have not set their delay.
        later_ns = wheels_ns - stamp_ns - max(median_low(self._delays_ns), 0)
        back_ns = 0 if self._last_ns is None else self._last_ns - stamp_ns
        begins = self._in_order and back_ns > SWAPPED * self._interval_ns
        if begins and 2 * later_ns > back_ns and not self._set_back_ns:
            self._set_back_ns, self._agreeing = later_ns, 0
        self._agreeing = self._agreeing + 1 if 2 * later_ns <= self._set_back_ns else 0
        if self._agreeing >= AGREEING:
            self._set_back_ns = 0
        return self._set_back_ns == 0
