# SPDX-License-Identifier: BSD-3-Clause
"""Text files: UTF-8, with or without a byte order mark, with line ends of any system.

Settings are read whole, tables line by line, because they may have millions of lines.
"""

from decimal import Decimal
from pathlib import Path
from typing import Iterator, List, NamedTuple, Sequence, Tuple

from ceiling_dso_ros.io.errors import InputError, reason_of
from ceiling_dso_ros.io.limits import LONGEST_LINE, MOST_SETTINGS_BYTES, MOST_TABLE_BYTES
from ceiling_dso_ros.io.stamps import stamps_in_ns


class TableLine(NamedTuple):
    """A line of a table, stripped; lines are counted from 1."""

    number: int
    text: str


def place_of_line(path: Path, number: int) -> str:
    """Where a line is, for messages."""
    return f"{path}, line {number}"


def read_text(path: Path) -> str:
    """The content of a text file with settings.

    Raises:
        InputError: the file cannot be read, is too large, or is not a text in UTF-8.
    """
    try:
        with path.open("rb") as file:
            content = file.read(MOST_SETTINGS_BYTES + 1)
        if len(content) > MOST_SETTINGS_BYTES:
            raise InputError(f"{path}: has more than {MOST_SETTINGS_BYTES} bytes, which no file with settings needs")
        return content.decode("utf-8-sig")  # editors on Windows put a byte order mark at the head
    except OSError as error:
        raise InputError(f"{path}: cannot read the file: {reason_of(error)}") from error
    except UnicodeDecodeError as error:
        raise _no_text(path, content[error.start], content.count(b"\n", 0, error.start) + 1) from error


def read_lines(path: Path) -> List[Tuple[str, str]]:
    """The lines of a text file with settings that are neither blank nor begin with #, stripped.

    Returns:
        Pairs of where the line is ("<path>, line 3"), for messages, and its text.

    Raises:
        InputError: as `read_text`.
    """
    lines = read_text(path).splitlines()
    numbered = ((place_of_line(path, number), line.strip()) for number, line in enumerate(lines, start=1))
    return [(where, line) for where, line in numbered if line and not line.startswith("#")]


def read_table(path: Path) -> Iterator[TableLine]:
    """The same of a table, one by one.

    Raises:
        InputError: the file cannot be read, or has too many or too long lines, or is not a text in UTF-8.
    """
    number = size = 0
    try:
        # Bytes that are none of UTF-8 become surrogates, which nothing else does.
        with path.open(encoding="utf-8-sig", errors="surrogateescape") as file:
            text = file.readline(LONGEST_LINE + 1)
            while text:
                number += 1
                size += len(text)
                _require_text(path, number, text)
                if len(text) > LONGEST_LINE:
                    raise InputError(f"{place_of_line(path, number)}: has more than {LONGEST_LINE} characters")
                if size > MOST_TABLE_BYTES:
                    raise InputError(f"{path}: has more than {MOST_TABLE_BYTES} bytes; split it")
                text = text.strip()
                if text and not text.startswith("#"):
                    yield TableLine(number, text)
                text = file.readline(LONGEST_LINE + 1)
    except OSError as error:
        raise InputError(f"{path}: cannot read the file: {reason_of(error)}") from error


def stamps_of_file(path: Path, stamps: Sequence[Decimal]) -> List[int]:
    """Nanoseconds of the stamps of all lines of a file; see `stamps_in_ns`.

    Raises:
        InputError: they are neither seconds nor nanoseconds.
    """
    try:
        return stamps_in_ns(stamps)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error


def increasing_stamps(path: Path, numbers: Sequence[int], stamps: Sequence[Decimal]) -> List[int]:
    """The same of lines with these numbers, whose stamps must increase.

    Raises:
        InputError: also where a stamp is not later than that of the line before.
    """
    stamps_ns = stamps_of_file(path, stamps)
    for number, before_ns, stamp_ns in zip(numbers[1:], stamps_ns, stamps_ns[1:]):
        if stamp_ns <= before_ns:
            same = "that of the line before; remove one of the two"
            what = same if stamp_ns == before_ns else "not later than the one before; sort the file"
            raise InputError(f"{place_of_line(path, number)}: the stamp is {what}")
    return stamps_ns


def _require_text(path: Path, number: int, text: str) -> None:
    if text.isascii():
        return
    try:
        text.encode("utf-8")
    except UnicodeEncodeError as error:
        raise _no_text(path, ord(text[error.start]) & 0xFF, number) from error


def _no_text(path: Path, byte: int, number: int) -> InputError:
    return InputError(f"{path}: is not a text file in UTF-8: byte 0x{byte:02x} in line {number}")
