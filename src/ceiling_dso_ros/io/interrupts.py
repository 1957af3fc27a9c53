# SPDX-License-Identifier: BSD-3-Clause
"""Delays Ctrl-C and SIGTERM until they do no harm."""

import signal
import threading
from contextlib import contextmanager
from types import FrameType
from typing import Iterator, List, Optional, Tuple

INTERRUPTS = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def deferred_interrupt() -> Iterator[None]:
    """Hold SIGINT and SIGTERM back until the end of the block.

    So files written in the block are complete. Also, compiled code turns an exception that a signal raises in it into a
    SystemError.
    """
    if threading.current_thread() is not threading.main_thread():  # signals only ever reach the main thread
        yield
        return
    received: List[Tuple[int, Optional[FrameType]]] = []
    handlers = {number: signal.signal(number, lambda *arguments: received.append(arguments)) for number in INTERRUPTS}
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for arguments in received[:1]:
            handler = handlers[signal.Signals(arguments[0])]
            if callable(handler):
                handler(*arguments)
            elif handler == signal.SIG_DFL:
                signal.raise_signal(arguments[0])


def was_interrupt(error: Optional[BaseException]) -> bool:
    """Whether an error is a KeyboardInterrupt, or the SystemError that compiled code made from one."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None
