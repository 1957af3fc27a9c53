# SPDX-License-Identifier: BSD-3-Clause
"""A buffer for one message, which keeps the newest."""

import threading
from typing import Any, Optional


class Mailbox:
    """Passes the newest message from the receiving thread to the working thread."""

    def __init__(self) -> None:
        self._condition = threading.Condition()
        self._message: Optional[Any] = None

    def put(self, message: Any) -> bool:  # noqa: ANN401
        """Store a message; True if it replaced one that was not taken."""
        with self._condition:
            replaced = self._message is not None
            self._message = message
            self._condition.notify()
        return replaced

    def take(self, timeout_s: float) -> Optional[Any]:  # noqa: ANN401
        """The newest message, or None when none arrives within timeout_s seconds."""
        with self._condition:
            self._condition.wait_for(lambda: self._message is not None, timeout_s)
            message, self._message = self._message, None
        return message
