"""Thins images to a rate, by their stamps alone, so that live and offline choose the same ones."""

from typing import Optional

EARLY_SHARE, EARLY_NS = 0.25, 10_000_000  # of a period, and at most, that an image may come early: cameras jitter
BACKWARDS_PERIODS = 2.0  # time that goes back further is another run; less are images out of order


class FrameRateLimit:
    """Lets images pass at about a rate.

    The images that pass lie near the ticks of a clock of that rate, which starts with the first image and again after a
    gap or when time goes back. So the mean rate is kept where the camera's rate is no multiple of it, and a camera that
    is slower than the rate loses nothing.

    Attributes:
        frame_rate: images a second; 0 lets all pass. May be changed at any time.
    """

    def __init__(self, frame_rate: float = 0.0) -> None:
        self.frame_rate = frame_rate
        self._due_ns: Optional[int] = None  # of the next tick

    def passes(self, stamp_ns: int) -> bool:
        """Whether the image of this stamp, nanoseconds, is to be used; to be asked once for each image, in order."""
        if self.frame_rate <= 0.0:
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
