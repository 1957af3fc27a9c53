# SPDX-License-Identifier: BSD-3-Clause
"""Exposure times that arrive on their own topic, looked up by image stamp."""

import math
import threading
import time
from collections import deque
from typing import Callable, Deque, Optional, Tuple

from ceiling_dso_ros.ros.waiting import wait_until

PATIENCE = 5  # images that wait in vain before images wait no longer


class ExposureLookup:
    """The last exposure times, by the stamp of the image they belong to."""

    def __init__(
        self,
        length: int = 100,
        monotonic_s: Callable[[], float] = time.monotonic,
        wait: Callable[[Callable[[], bool], float], bool] = wait_until,
    ) -> None:
        self._monotonic_s, self._wait_until = monotonic_s, wait
        self._lock = threading.Lock()
        self._exposures: Deque[Tuple[int, Optional[float]]] = deque(maxlen=length)
        self._asked_ns, self._asked_until_s = 0, -math.inf  # stamp that was asked for last, and how long it may wait
        self._misses = 0

    @property
    def is_late(self) -> bool:
        """Whether exposures come too late for their images or not at all, so that images do not wait for them."""
        return self._misses >= PATIENCE

    def add(self, stamp_ns: int, exposure_ms: Optional[float]) -> None:
        """Store one, None for an exposure that is unknown; a stamp that goes backwards clears all others."""
        with self._lock:
            if self._exposures and stamp_ns < self._exposures[-1][0]:
                self._exposures.clear()
                self._asked_ns = 0
            self._exposures.append((stamp_ns, exposure_ms))
            in_time = stamp_ns == self._asked_ns and self._monotonic_s() <= self._asked_until_s
            if in_time or stamp_ns > self._asked_ns:
                self._misses = 0

    def at(self, stamp_ns: int, timeout_s: float) -> Optional[float]:
        """Exposure in ms of the image with this stamp; None when it is unknown.

        Waits up to timeout_s seconds for it, because image and exposure come over different connections. After several
        images that have waited in vain, further ones do not wait, until an exposure comes in time again.
        """
        with self._lock:
            self._asked_ns, self._asked_until_s = stamp_ns, self._monotonic_s() + timeout_s
        is_known = self._wait_until(lambda: self._has_come(stamp_ns), 0.0 if self.is_late else timeout_s)
        with self._lock:
            if timeout_s > 0.0:
                self._misses = 0 if is_known else self._misses + 1
            return next((exposure for stamp, exposure in reversed(self._exposures) if stamp == stamp_ns), None)

    def _has_come(self, stamp_ns: int) -> bool:
        with self._lock:
            return bool(self._exposures) and self._exposures[-1][0] >= stamp_ns
