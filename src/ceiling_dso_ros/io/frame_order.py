# SPDX-License-Identifier: BSD-3-Clause
"""Which images of a recording have a stamp that can be believed: single wrong ones, and clocks that were set."""

from typing import TYPE_CHECKING, Iterable, Iterator, Optional, Tuple

from ceiling_dso_ros.io.arrival_clock import ClockAgreement, set_alone
from ceiling_dso_ros.io.stamps import format_stamp

if TYPE_CHECKING:
    from ceiling_dso_ros.io.recording import ListedImage, WheelSamples

PAUSE_NS = 10**9  # a longer one is only believed once the next image follows it
SWAPPED = 1.5  # intervals: two images that changed places go back by one


def judged(
    images: Iterable["ListedImage"], wheels: Optional["WheelSamples"] = None
) -> Iterator[Tuple["ListedImage", str]]:
    """The images with what is wrong with their stamps, in words; empty where nothing is, or where there is none.

    An image far ahead of the one before is wrong when the next one is not: it costs itself, not all that follow. When
    stamps go back by more than two images that changed places, and the next one follows them, the camera's clock was
    set. Where it is known when images and wheels were recorded, clocks that were set alone are known with it, and when
    they are right again.

    Args:
        images: in the order of the recording.
        wheels: with which they are used: by a clock that alone was set, images have no known time.
    """
    order, clocks = _Order(wheels is not None and not wheels.set_back), _Clocks(wheels)
    held: Optional[ListedImage] = None
    for image in images:
        apart = clocks.fault(image)
        if held is not None:
            yield held, order.fault(held.stamp_ns, None if apart else image.stamp_ns)
            held = None
        if apart:
            yield image, apart
        elif order.surprises(image.stamp_ns):
            held = image
        else:
            yield image, order.fault(image.stamp_ns)
    if held is not None:
        yield held, order.fault(held.stamp_ns)


class _Clocks:
    """Compares the clocks of images and wheels by when they were recorded."""

    def __init__(self, wheels: Optional["WheelSamples"]) -> None:
        self._clocks = ClockAgreement()
        self._arrivals_ns = None if wheels is None else wheels.arrivals_ns
        self._next = 0  # row of the wheels

    def fault(self, image: "ListedImage") -> str:
        """That the clocks disagree at an image, in words; empty where they do not, or nothing is known."""
        if self._arrivals_ns is None or image.stamp_ns is None or image.recorded_ns is None:
            return ""
        while self._next < len(self._arrivals_ns) and self._arrivals_ns[self._next, 1] <= image.recorded_ns:
            self._clocks.take_wheels(*self._arrivals_ns[self._next].tolist())
            self._next += 1
        self._clocks.take_image(image.stamp_ns, image.recorded_ns)
        return self._clocks.disagreement


class _Order:
    """Judges stamps one after the other."""

    def __init__(self, alone: bool) -> None:
        self._alone = alone
        self._last_ns: Optional[int] = None
        self._interval_ns = 0
        self._set_back_ns = 0

    def surprises(self, stamp_ns: Optional[int]) -> bool:
        """Whether a stamp is the first, far ahead or far back, so that only the next one confirms it."""
        if stamp_ns is None or self._set_back_ns:
            return False
        if self._last_ns is None:
            return True
        step_ns = stamp_ns - self._last_ns
        return step_ns > PAUSE_NS or step_ns < -SWAPPED * self._interval_ns

    def fault(self, stamp_ns: Optional[int], next_ns: Optional[int] = None) -> str:
        """What is wrong with the next stamp, given the one after it where it is known; empty where nothing is."""
        if stamp_ns is None:
            return ""
        if self._set_back_ns:
            return self._set_back()
        if next_ns is not None and next_ns < stamp_ns and (self._last_ns is None or stamp_ns > self._last_ns):
            return "the stamp lies far ahead of the next one"
        if self._last_ns is None:
            self._last_ns = stamp_ns
            return ""
        step_ns = stamp_ns - self._last_ns
        if step_ns > 0:
            self._last_ns, self._interval_ns = stamp_ns, min(step_ns, PAUSE_NS)
            return ""
        if self._alone and next_ns is not None and stamp_ns < next_ns <= self._last_ns:
            self._set_back_ns = self._interval_ns - step_ns
            return self._set_back()
        return f"the stamp {format_stamp(stamp_ns)} {'lies before' if step_ns else 'repeats'} that of the last frame"

    def _set_back(self) -> str:
        return set_alone("images", "wheels", -self._set_back_ns)
