# SPDX-License-Identifier: BSD-3-Clause
"""Which images of a recording have a stamp that can be believed: single wrong ones, and clocks that were set."""

from typing import TYPE_CHECKING, Iterable, Iterator, Optional, Tuple

from ceiling_dso_ros.io.stamps import NANOSECONDS, format_stamp

if TYPE_CHECKING:
    from ceiling_dso_ros.io.recording import ListedImage

PAUSE_NS = 10**9  # a longer one is only believed once the next image follows it
SWAPPED = 1.5  # intervals: two images that changed places go back by one


def judged(images: Iterable["ListedImage"], alone: bool) -> Iterator[Tuple["ListedImage", str]]:
    """The images with what is wrong with their stamps, in words; empty where nothing is, or where there is none.

    An image far ahead of the one before is wrong when the next one is not: it costs itself, not all that follow. When
    stamps go back by more than two images that changed places, the camera's clock was set.

    Args:
        images: in the order of the recording.
        alone: the wheels' clock was not set back, so that images by a clock that was have no known time.
    """
    order = _Order(alone)
    held: Optional[ListedImage] = None
    for image in images:
        if held is not None:
            wrong = image.stamp_ns is not None and held.stamp_ns is not None and image.stamp_ns < held.stamp_ns
            yield held, "the stamp lies far ahead of the next one" if wrong else order.fault(held.stamp_ns)
            held = None
        if order.leaps(image.stamp_ns):
            held = image
        else:
            yield image, order.fault(image.stamp_ns)
    if held is not None:
        yield held, order.fault(held.stamp_ns)


class _Order:
    """Judges stamps one after the other."""

    def __init__(self, alone: bool) -> None:
        self._alone = alone
        self._last_ns: Optional[int] = None
        self._interval_ns = 0
        self._set_back_ns = 0

    def leaps(self, stamp_ns: Optional[int]) -> bool:
        """Whether a stamp is far later than the last one, or the first, so that only the next one confirms it."""
        return stamp_ns is not None and (self._last_ns is None or stamp_ns > self._last_ns + PAUSE_NS)

    def fault(self, stamp_ns: Optional[int]) -> str:
        """What is wrong with the next stamp; empty where nothing is."""
        if stamp_ns is None:
            return ""
        if self._last_ns is None:
            self._last_ns = stamp_ns
            return ""
        if self._set_back_ns:
            back_s = self._set_back_ns / NANOSECONDS
            return f"the clock of the images was set back by {back_s:.2f} s, that of the wheels was not"
        step_ns = stamp_ns - self._last_ns
        if step_ns > 0:
            self._last_ns, self._interval_ns = stamp_ns, min(step_ns, PAUSE_NS)
            return ""
        if self._alone and step_ns < -SWAPPED * self._interval_ns:
            self._set_back_ns = self._interval_ns - step_ns
            return self.fault(stamp_ns)
        return f"the stamp {format_stamp(stamp_ns)} {'lies before' if step_ns else 'repeats'} that of the last frame"
