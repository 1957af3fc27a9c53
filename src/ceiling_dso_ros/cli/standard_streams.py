# SPDX-License-Identifier: BSD-3-Clause
"""Standard output and error that nobody may read: what is lost there does not end a command."""

import os
import sys
from typing import Any, Optional, TextIO, cast


class ForgivingStream:
    """A text stream; after an error in writing, all further text is thrown away.

    Attributes:
        error: the first error; None without one.
    """

    def __init__(self, stream: TextIO) -> None:
        self.error: Optional[OSError] = None
        self._stream = stream

    def write(self, text: str) -> int:
        """Write, or do not."""
        try:
            self._stream.write(text)
        except OSError as error:
            self._close(error)
        return len(text)

    def flush(self) -> None:
        """Write what is buffered, or do not."""
        try:
            self._stream.flush()
        except OSError as error:
            self._close(error)

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 everything else is the stream's
        return getattr(self._stream, name)

    def _close(self, error: OSError) -> None:
        self.error = self.error or error
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self._stream.fileno())  # where the rest of the buffer goes
        os.close(nowhere)


def forgive_standard_streams() -> ForgivingStream:
    """Replace standard output and error by forgiving ones; returns the output.

    Streams that were closed before the process began are opened again, or their numbers would be those of the first
    files that a command writes.
    """
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the smallest number that is free
    for number, name in ((1, "stdout"), (2, "stderr")):
        setattr(sys, name, ForgivingStream(getattr(sys, name) or os.fdopen(number, "w")))
    return cast(ForgivingStream, sys.stdout)
