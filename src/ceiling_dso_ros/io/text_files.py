# SPDX-License-Identifier: BSD-3-Clause
"""Text files: UTF-8, with or without a byte order mark, with line ends of any system."""

from pathlib import Path
from typing import List, Tuple

from ceiling_dso_ros.io.errors import InputError


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
