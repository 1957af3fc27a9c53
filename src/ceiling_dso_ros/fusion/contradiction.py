# SPDX-License-Identifier: BSD-3-Clause
"""Whom to believe when images between two keyframes contradict the wheels."""

from typing import Optional

from ceiling_dso_ros.dso.durations import LONG_AGO_NS, nanoseconds
from ceiling_dso_ros.fusion.config import SlipConfig

UNSEEN_NS = nanoseconds(0.3)  # a slip ends when images agree with the wheels, or when there were none for this time


class Contradiction:
    """Wheels that contradict an image slip, but not for long if the camera says that the robot stands.

    A robot that moves gets a new keyframe every few images, whatever its wheels do. So images without a new keyframe
    that contradict turning wheels come from a robot that stands, or from a camera that shows the same picture all the
    time. The two look the same. After some time the camera is doubted, until the next keyframe: a robot that is taken
    to stand while it drives is worse than one that is taken to drive, since only the second one's covariance grows.

    Attributes:
        since_ns: since when all images have contradicted the wheels, nanoseconds; None when the last one did not.
        camera_doubted: the camera's motions are not used.
    """

    def __init__(self, config: SlipConfig) -> None:
        self._longest_ns = nanoseconds(config.longest_s)
        self._last_ns, self._at_once = LONG_AGO_NS, False
        self.since_ns: Optional[int] = None
        self.camera_doubted = False

    def lasts(self, now_ns: int) -> bool:
        """Whether the wheels contradict the images now."""
        return self.since_ns is not None and now_ns < self._last_ns + UNSEEN_NS

    def replaces_wheels(self, now_ns: int) -> bool:
        """Whether the wheels' newest motion is wrong, so that it must not be used."""
        return self._at_once and self.lasts(now_ns) and not self.camera_doubted

    def new_keyframe(self, stamp_ns: int) -> None:
        """Take note of a keyframe: the camera shows that it moves."""
        self.camera_doubted = False
        if self.since_ns is not None:
            self.since_ns = max(self.since_ns, stamp_ns)

    def found(self, start_ns: int, end_ns: int, at_once: bool) -> None:
        """Take note of a motion between two images that contradicts the wheels; at once: of two consecutive ones."""
        self._last_ns, self._at_once = end_ns, at_once
        if self.since_ns is None:
            self.since_ns = start_ns
        self.camera_doubted = self.camera_doubted or end_ns - self.since_ns > self._longest_ns

    def not_found(self) -> None:
        """Take note of images that do not contradict the wheels."""
        self.since_ns, self._at_once = None, False
