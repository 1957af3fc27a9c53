# SPDX-License-Identifier: BSD-3-Clause
"""Leaves images out while hardly anything moves, by their stamps and what is known of the motion alone."""

import enum
import math
from collections import Counter, deque
from typing import Any, Deque, Dict, Optional
from typing import Counter as CounterOf

from ceiling_dso_ros.dso import PinholeCamera
from ceiling_dso_ros.dso.durations import nanoseconds, seconds
from ceiling_dso_ros.dso.tracking.track_history import ExpectedMotion

LONGEST_S = 0.5  # from one used image to the next
SETTLING_S = 2.0  # after an image without a pose, such as those before the first map: a young map needs many views
FAST_TURN_RAD_S = 0.85  # faster than in driving along: then every image counts
GROWN = 1.3  # of the photometric error, over the usual one
SLOWNESS = 20  # images over which the usual error is averaged
# Flow of the points, a share of width + height: keyframes are 0.019 apart, if the camera does not turn.
MOST_FLOW = 0.009
# Of the view, without wheels that would tell: 2 m/s^2 under a ceiling 2 m away, and 4 rad/s^2 seen 0.65 focal lengths
# from the axis. These are the fusion's largest accelerations of a robot (`output.acceleration_m_s2` and `_rad_s2`).
LARGEST_ACCELERATION_RAD_S2 = 2.8
RECENT_NS = nanoseconds(2.0)  # the rate is that of such a time


class RateReason(enum.IntEnum):
    """Why an image is used, or left out; the numbers are those of VisualOdometryStatus.msg."""

    EVERY = 0  # all are: the rate is not regulated
    STARTING = 1  # there is no map, or an image had no pose a short time ago
    TURNING = 2  # the camera turns fast
    ERROR = 3  # the photometric error has grown
    MOVED = 4  # the camera may have moved far enough
    DUE = 5  # none was used for a long time
    LEFT_OUT = 6  # hardly anything has moved


USING = tuple(reason for reason in RateReason if reason not in (RateReason.EVERY, RateReason.LEFT_OUT))


class FrameRegulation:
    """Decides for each image whether it is used; the same stamps and motions give the same decisions.

    Attributes:
        reason: why the newest image was used or left out.
        counts: number of images with each reason.
    """

    def __init__(self, camera: PinholeCamera) -> None:
        """Begin.

        Args:
            camera: of the images as they are tracked.
        """
        self._most_flow_px = MOST_FLOW * (camera.width + camera.height)
        self._acceleration_px_s2 = LARGEST_ACCELERATION_RAD_S2 * camera.fx
        self.counts: CounterOf[RateReason] = Counter()
        self.restart()

    def restart(self) -> None:
        """Forget the images, but not their numbers."""
        self.reason = RateReason.STARTING
        self._used_ns: Deque[int] = deque()
        self._untracked_ns: Optional[int] = None
        self._error = self._usual_error = math.inf

    def leaves_out(self, stamp_ns: int, expected: Optional[ExpectedMotion]) -> bool:
        """Decide for an image; call it once for each, in order.

        Args:
            stamp_ns: its stamp, nanoseconds. What is not later than the last one that was used is not left out.
            expected: motion since the last image with a pose; None where nothing is known of it.
        """
        self.reason = self._judge(stamp_ns, expected)
        self.counts[self.reason] += 1
        return self.reason is RateReason.LEFT_OUT

    def use(self, stamp_ns: int, rmse: Optional[float]) -> None:
        """Take note of a used image.

        Args:
            stamp_ns: its stamp, nanoseconds.
            rmse: photometric error of its pose, grey levels; None without a pose.
        """
        self._used_ns.append(stamp_ns)
        while self._used_ns[0] <= stamp_ns - RECENT_NS:
            self._used_ns.popleft()
        if rmse is None or self._untracked_ns is None:
            self._untracked_ns = stamp_ns
        if rmse is None:
            self._usual_error = math.inf
            return
        self._error = rmse
        known = math.isfinite(self._usual_error)
        self._usual_error = self._usual_error + (rmse - self._usual_error) / SLOWNESS if known else rmse

    def rate_hz(self, stamp_ns: int) -> float:
        """Images a second that were used of late, at a stamp."""
        return sum(used_ns > stamp_ns - RECENT_NS for used_ns in self._used_ns) / seconds(RECENT_NS)

    def summary(self) -> Dict[str, Any]:
        """How many images were used and left out so far, and for which reasons they were used."""
        left_out = self.counts[RateReason.LEFT_OUT]
        used = {reason.name.lower(): self.counts[reason] for reason in USING}
        return {"used": sum(used.values()), "left_out": left_out, "reasons": used}

    def _judge(self, stamp_ns: int, expected: Optional[ExpectedMotion]) -> RateReason:
        if expected is None or self._untracked_ns is None or seconds(stamp_ns - self._untracked_ns) < SETTLING_S:
            return RateReason.STARTING
        since_s = seconds(stamp_ns - self._used_ns[-1])
        if not 0.0 < since_s < LONGEST_S:
            return RateReason.DUE
        if expected.turn_rad > FAST_TURN_RAD_S * since_s:
            return RateReason.TURNING
        if self._error > GROWN * self._usual_error:
            return RateReason.ERROR
        surprise_px = 0.0 if expected.predicted else 0.5 * self._acceleration_px_s2 * since_s**2
        return RateReason.MOVED if expected.flow_px + surprise_px > self._most_flow_px else RateReason.LEFT_OUT
