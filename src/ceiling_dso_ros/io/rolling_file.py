# SPDX-License-Identifier: BSD-3-Clause
"""A file that grows for weeks without filling the disk."""

import os
import threading
from pathlib import Path
from typing import BinaryIO, Iterator, List, Optional

from ceiling_dso_ros.io.errors import InputError, reason_of

MOST_PENDING = 2**22  # bytes that wait for a disk that does not answer; several minutes of a node's results
CHUNK = 2**20
LONGEST_RECORD = 10_000  # bytes of a record or a line


class RollingFile:
    """Appends to a file, of which the oldest part is given up when it reaches a limit.

    It consists of NAME and, once half of the limit is reached, of NAME.old with what came before. What is appended
    reaches the disk with `flush`, in another thread than those which must not wait for a disk.

    Args:
        path: NAME; the folder exists.
        limit: largest size of both files together, bytes. At least half of that is kept.

    Attributes:
        lost: number of results that were given up since the begin because the disk did not take them.
    """

    def __init__(self, path: Path, limit: int) -> None:
        self._path, self._half = path, limit // 2
        self._file: Optional[BinaryIO] = None
        self._size = 0
        self._lock = threading.Lock()  # of what waits, never held while the disk works
        self._pending: List[bytes] = []
        self._pending_size = self._pending_count = 0
        self.lost = 0
        self._run = self._run_on_disk = 0  # counts what begins anew

    def append(self, record: bytes, count: int = 1) -> None:
        """Add something that stays together, with a number of results: it is kept or given up as a whole."""
        with self._lock:
            if self._pending_size + len(record) > MOST_PENDING:
                self.lost += self._pending_count
                self._empty()
            self._pending.append(record)
            self._pending_size += len(record)
            self._pending_count += count

    def clear(self) -> None:
        """Begin anew, with the next flush."""
        with self._lock:
            self._empty()
            self._run += 1

    def flush(self) -> None:
        """Write what was appended; one thread at a time.

        Raises:
            OSError: it cannot be written, and is given up. What was written before stays whole.
        """
        with self._lock:
            pending, count, run = b"".join(self._pending), self._pending_count, self._run
            self._empty()
        try:
            if run != self._run_on_disk:
                self._begin_anew()
                self._run_on_disk = run
            if pending:
                if self._size > 0 and self._size + len(pending) > self._half:
                    self._roll()
                self._write(pending)
        except OSError:
            with self._lock:
                self.lost += count
            raise

    def close(self) -> None:
        """Close the file; a flush would open it again."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def _empty(self) -> None:
        self._pending, self._pending_size, self._pending_count = [], 0, 0

    def _begin_anew(self) -> None:
        self.close()
        for path in (self._path, old_part(self._path)):
            if path.exists():
                path.unlink()
        self._size = 0

    def _roll(self) -> None:
        self.close()
        self._path.replace(old_part(self._path))
        self._size = 0

    def _write(self, data: bytes) -> None:
        if self._file is None:
            self._file = self._path.open("ab", buffering=0)
        try:
            rest = memoryview(data)
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError:
            os.ftruncate(self._file.fileno(), self._size)
            raise
        self._size += len(data)


def old_part(path: Path) -> Path:
    """Where a rolling file keeps what came before its newest part; there is none while it is small."""
    return path.with_name(path.name + ".old")


def read_rolling(path: Path, record_size: int = 0) -> Iterator[bytes]:
    """Read a rolling file, the oldest part first, in pieces that hold whole records.

    Args:
        path: the file; nothing is read if there is none.
        record_size: bytes of a record; 0 for lines of text. What follows the last whole record is left out: a machine
            that has lost its power may leave a part of one.

    Raises:
        InputError: it cannot be read.
    """
    for part in (old_part(path), path):
        if part.exists():
            yield from _whole_records(part, record_size)


def _whole_records(path: Path, record_size: int) -> Iterator[bytes]:
    rest = b""
    for chunk in _chunks(path):
        rest += chunk
        end = rest.rfind(b"\n") + 1 if record_size == 0 else len(rest) // record_size * record_size
        if end == 0 and len(rest) > LONGEST_RECORD:  # no lines: for those who can tell what is damaged
            end = len(rest)
        if end:
            yield rest[:end]
            rest = rest[end:]


def _chunks(path: Path) -> Iterator[bytes]:
    try:
        with path.open("rb") as file:
            chunk = file.read(CHUNK)
            while chunk:
                yield chunk
                chunk = file.read(CHUNK)
    except OSError as error:
        raise InputError(f"{path}: cannot read the file: {reason_of(error)}") from error
