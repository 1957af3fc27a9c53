# SPDX-License-Identifier: BSD-3-Clause
"""Exposure times that arrive on their own topic, looked up by image stamp."""

import threading
from collections import deque
from typing import Deque, Optional, Tuple


class ExposureLookup:
    """The last exposure times, by the stamp of the image they belong to."""

    def __init__(self, length: int = 100) -> None:
        self._condition = threading.Condition()
        self._exposures: Deque[Tuple[int, Optional[float]]] = deque(maxlen=length)

    def add(self, stamp_ns: int, exposure_ms: Optional[float]) -> None:
        """Store one, None for an exposure that is unknown; a stamp that goes backwards clears all others."""
        with self._condition:
            if self._exposures and stamp_ns < self._exposures[-1][0]:
                self._exposures.clear()
            self._exposures.append((stamp_ns, exposure_ms))
            self._condition.notify_all()

    def at(self, stamp_ns: int, timeout_s: float) -> Optional[float]:
        """Exposure in ms of the image with this stamp; None when it is unknown.

        Waits up to timeout_s seconds for it: image and exposure come over different connections.
        """
        with self._condition:
            self._condition.wait_for(lambda: bool(self._exposures) and self._exposures[-1][0] >= stamp_ns, timeout_s)
            return next((exposure for stamp, exposure in reversed(self._exposures) if stamp == stamp_ns), None)
