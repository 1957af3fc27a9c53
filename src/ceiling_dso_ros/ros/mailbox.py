# SPDX-License-Identifier: BSD-3-Clause
"""A buffer for one message, which keeps the newest."""

import threading
from typing import Any, Optional


class Mailbox:
    """Passes the newest message from the receiving thread to the working thread."""

    def __init__(self) -> None:
        self._condition = threading.Condition()
        self._message: Optional[Any] = None
        self._is_closed = False

    def put(self, message: Any) -> bool:  # noqa: ANN401
        """Store a message; True if it replaced one that was not taken."""
        with self._condition:
            replaced = self._message is not None
            self._message = message
            self._condition.notify()
        return replaced

    def take(self) -> Optional[Any]:  # noqa: ANN401
        """Wait for a message and take the newest; None once the mailbox is closed."""
        with self._condition:
            self._condition.wait_for(lambda: self._is_closed or self._message is not None)
            message, self._message = self._message, None
        return None if self._is_closed else message

    def close(self) -> None:
        """End all waiting."""
        with self._condition:
            self._is_closed = True
            self._condition.notify_all()
