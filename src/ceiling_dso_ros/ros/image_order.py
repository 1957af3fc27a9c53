# SPDX-License-Identifier: BSD-3-Clause
"""Which images fusion_node may use: those of the present run, in order, at the wheels' time."""

from typing import Callable, Optional

from ceiling_dso_ros.dso.durations import seconds
from ceiling_dso_ros.io.arrival_clock import ClockAgreement
from ceiling_dso_ros.ros.data_clock import BACKWARDS_NS
from ceiling_dso_ros.ros.node import arrival_clock

CAMERA_AHEAD_NS = 10**9  # right after a restart, images this far ahead of the wheels belong to the run before


class ImageOrder:
    """Judges stamps of images, which are on the wheels' clock, nanoseconds."""

    def __init__(self, is_simulated: bool, now_ns: Optional[Callable[[], int]] = None) -> None:
        """Begin a run.

        Args:
            is_simulated: the clock is never set, but a bag may be played again.
            now_ns: `arrival_clock`, unless it is that of a test.
        """
        self._is_simulated = is_simulated
        self._now_ns = now_ns or arrival_clock(is_simulated)
        self._clocks = ClockAgreement()
        self.reset()

    def reset(self) -> None:
        """Begin a new run."""
        self._wheels_heard_ns = 0
        self._apart_s = 0.0
        self._last_ns: Optional[int] = None
        self._clocks.forget()
        self._may_be_old = True

    def heard_wheels(self, stamp_ns: int) -> None:
        """A wheel sample with that stamp has arrived."""
        self._wheels_heard_ns = self._now_ns()
        self._clocks.take_wheels(stamp_ns, self._wheels_heard_ns)

    def heard_image(self, stamp_ns: int) -> None:
        """The status of an image with that stamp has arrived."""
        self._clocks.take_image(stamp_ns, self._now_ns())

    @property
    def apart(self) -> str:
        """That images and wheels are on two clocks, in words; empty while they seem to be on one."""
        if self.disagrees:
            remedy = "images are not used until the two agree again; if they are right as they are, call ~reset"
            return f"{self._clocks.disagreement}: {remedy}"
        if abs(self._apart_s) <= seconds(CAMERA_AHEAD_NS):
            return ""
        order = "after" if self._apart_s > 0.0 else "before"
        late = "the wheels" if self._apart_s > 0.0 else "images"
        apart = f"{abs(self._apart_s):.1f} s {order} those of the wheels"
        return f"stamps of images are {apart}: two clocks, or {late} come late"

    @property
    def disagrees(self) -> bool:
        """The clock of the images was set, or that of the wheels, and not both, so that images are not used."""
        return self.ahead_ns != 0

    @property
    def ahead_ns(self) -> int:
        """By how much the images' clock seems to be ahead of that of the wheels; 0 unless they disagree."""
        return self._clocks.apart_ns

    def agree(self) -> None:
        """Nobody has set a clock: it was something else."""
        self._clocks.forget()

    def is_usable(self, stamp_ns: int, wheels_ns: Optional[int], complain: Callable[[str], None]) -> bool:
        """Whether to use an image.

        Args:
            stamp_ns: of the image.
            wheels_ns: of the newest wheel sample; None before the first.
            complain: takes what is wrong with an image of this run.
        """
        # Where the clock has been set ahead, images may come before the wheels tell of it: these are not silent.
        wheels_are_silent = self._now_ns() - self._wheels_heard_ns >= BACKWARDS_NS
        self._apart_s = 0.0 if wheels_ns is None or wheels_are_silent else seconds(stamp_ns - wheels_ns)
        if wheels_ns is None or (self._may_be_old and stamp_ns > wheels_ns + CAMERA_AHEAD_NS):
            return False
        self._may_be_old = False
        if not self._is_simulated and stamp_ns > wheels_ns + BACKWARDS_NS and not wheels_are_silent:
            complain("an image that is far ahead of the wheels")
            return False
        if self.disagrees:
            complain("an image while its clock does not agree with that of the wheels")
            return False
        # Where the clock has been set back, images may come before the wheels tell by how much.
        if self._last_ns is not None and stamp_ns <= self._last_ns <= wheels_ns + CAMERA_AHEAD_NS:
            complain("an image that is not later than the last one")
            return False
        self._last_ns = stamp_ns
        return True
