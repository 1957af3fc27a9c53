# SPDX-License-Identifier: BSD-3-Clause
"""Text files: UTF-8, with or without a byte order mark, with line ends of any system."""

from decimal import Decimal
from pathlib import Path
from typing import List, Sequence, Tuple

from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.stamps import stamps_in_ns


def read_text(path: Path) -> str:
    """The content of a text file.

    Raises:
        InputError: the file cannot be read or is not a text in UTF-8.
    """
    try:
        content = path.read_bytes()
        return content.decode("utf-8-sig")  # editors on Windows put a byte order mark at the head
    except OSError as error:
        raise InputError(f"{path}: cannot read the file: {error.strerror}") from error
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise InputError(
            f"{path}: is not a text file in UTF-8: byte 0x{content[error.start]:02x} in line {line}"
        ) from error


def read_lines(path: Path) -> List[Tuple[str, str]]:
    """The lines of a text file that are neither blank nor begin with #, stripped.

    Returns:
        Pairs of where the line is ("<path>, line 3"), for messages, and its text.

    Raises:
        InputError: the file cannot be read or is not a text in UTF-8.
    """
    lines = read_text(path).splitlines()
    numbered = ((f"{path}, line {number}", line.strip()) for number, line in enumerate(lines, start=1))
    return [(where, line) for where, line in numbered if line and not line.startswith("#")]


def stamps_of_file(path: Path, stamps: Sequence[Decimal]) -> List[int]:
    """Nanoseconds of the stamps of all lines of a file; see `stamps_in_ns`.

    Raises:
        InputError: they are neither seconds nor nanoseconds.
    """
    try:
        return stamps_in_ns(stamps)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error


def increasing_stamps(path: Path, lines: Sequence[Tuple[str, Decimal]]) -> List[int]:
    """The same of pairs of where a line is and its stamp, which must increase.

    Raises:
        InputError: also where a stamp is not later than that of the line before.
    """
    stamps_ns = stamps_of_file(path, [stamp for _, stamp in lines])
    for (where, _), before_ns, stamp_ns in zip(lines[1:], stamps_ns, stamps_ns[1:]):
        if stamp_ns == before_ns:
            raise InputError(f"{where}: the stamp is that of the line before; remove one of the two")
        if stamp_ns < before_ns:
            raise InputError(f"{where}: the stamp is not later than the one before; sort the file")
    return stamps_ns
