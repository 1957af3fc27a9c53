# SPDX-License-Identifier: BSD-3-Clause
"""Whom to believe when images contradict the wheels."""

from typing import Optional

import numpy as np

from ceiling_dso_ros.dso.durations import LONG_AGO_NS, nanoseconds
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.config import SlipConfig

UNSEEN_NS = nanoseconds(0.3)  # a slip ends when images agree with the wheels, or when there were none for this time
STANDS_M, STANDS_RAD = 0.02, 0.01  # a camera that vibrates seems to move by less


class Contradiction:
    """Wheels that contradict an image slip, but not for long if the camera says that the robot stands.

    Images that stay where they are while the wheels turn come from a robot that stands, or from a camera that shows the
    same picture all the time: its driver hangs, or the robot carries what it sees. These look the same. After some time
    the camera is doubted, until it moves: a robot that is taken to stand while it drives is worse than one that is
    taken to drive, since only the second one's covariance grows.

    Attributes:
        since_ns: since when all images have contradicted the wheels, nanoseconds; None when the last one did not.
        camera_doubted: the camera's motions are not used.
        doubted_since_ns: since when it has been doubted, or was the last time, nanoseconds.
    """

    def __init__(self, config: SlipConfig) -> None:
        self._longest_ns = nanoseconds(config.longest_s)
        self._last_ns, self._at_once = LONG_AGO_NS, False
        self._way = np.zeros(3)  # of the base by the camera, since it began to contradict the wheels
        self.since_ns: Optional[int] = None
        self.camera_doubted = False
        self.doubted_since_ns = LONG_AGO_NS

    def lasts(self, now_ns: int) -> bool:
        """Whether the wheels contradict the images now."""
        return self.since_ns is not None and now_ns < self._last_ns + UNSEEN_NS

    def replaces_wheels(self, now_ns: int) -> bool:
        """Whether the wheels' newest motion is wrong, so that it must not be used."""
        return self._at_once and self.lasts(now_ns) and not self.camera_doubted

    def found(self, start_ns: int, end_ns: int, seen: np.ndarray, at_once: bool) -> None:
        """Take note of a motion between two images that contradicts the wheels.

        Args:
            start_ns, end_ns: stamps of the images.
            seen: (3,) motion of the base by the camera.
            at_once: they are consecutive ones; otherwise the motion from an earlier image to the second one does.
        """
        self._last_ns, self._at_once = end_ns, at_once
        if self.since_ns is None:
            self.since_ns = start_ns
        self._follow(end_ns, seen)
        if not self.camera_doubted and end_ns - self.since_ns > self._longest_ns:
            self.camera_doubted, self.doubted_since_ns = True, self.since_ns

    def not_found(self, end_ns: int, seen: np.ndarray) -> None:
        """Take note of images that do not contradict the wheels."""
        self._follow(end_ns, seen)
        self.since_ns, self._at_once = None, False

    def _follow(self, end_ns: int, seen: np.ndarray) -> None:
        """Believe the camera from the moment on at which it has moved."""
        if self.since_ns is None and not self.camera_doubted:
            self._way = np.zeros(3)
            return
        self._way = planar.compose(self._way, seen)
        if has_moved(self._way):
            self._way, self.camera_doubted = np.zeros(3), False
            if self.since_ns is not None:
                self.since_ns = end_ns


def has_moved(motion: np.ndarray) -> bool:
    """Whether a (3,) motion of the base by the camera is more than that of a camera that vibrates."""
    return bool(np.hypot(*motion[:2]) > STANDS_M or abs(motion[2]) > STANDS_RAD)
