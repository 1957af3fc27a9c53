# SPDX-License-Identifier: BSD-3-Clause
"""A buffer between the thread that receives messages and the one that works on them."""

import threading
import time
from collections import deque
from typing import Any, Deque, Optional

LATE_S = 0.2  # messages wait for so long: a third of the time after which the fusion no longer expects an image
SHARE = 0.2  # of the newest message in the mean time that one takes


class Mailbox:
    """Passes messages on in their order, and leaves out the oldest when the work does not keep up.

    Messages that come all at once, after a pause of the network or of their driver, are worked off one after the other:
    small steps are easier than a large one.
    """

    def __init__(self) -> None:
        self._condition = threading.Condition()
        self._messages: Deque[Any] = deque()
        self._taken_s: Optional[float] = None  # when the worker took the message that it works on
        self._work_s = 0.0  # that one takes in the mean
        self._is_closed = False

    def put(self, message: Any) -> int:  # noqa: ANN401
        """Store a message; returns how many older ones are left out for it."""
        dropped = 0
        with self._condition:
            self._messages.append(message)
            while len(self._messages) > 1 and len(self._messages) * self._work_s > LATE_S:
                self._messages.popleft()
                dropped += 1
            self._condition.notify()
        return dropped

    def take(self) -> Optional[Any]:  # noqa: ANN401
        """Wait for a message and take the oldest; None once the mailbox is closed.

        The time from here to the next call is what the work on it takes.
        """
        now_s = time.monotonic()
        with self._condition:
            if self._taken_s is not None:
                self._work_s += SHARE * (now_s - self._taken_s - self._work_s)
            self._condition.wait_for(lambda: self._is_closed or self._messages)
            self._taken_s = time.monotonic()
            return None if self._is_closed else self._messages.popleft()

    def close(self) -> None:
        """End all waiting."""
        with self._condition:
            self._is_closed = True
            self._condition.notify_all()
