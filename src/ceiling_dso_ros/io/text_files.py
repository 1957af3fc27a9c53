# SPDX-License-Identifier: BSD-3-Clause
"""Text files made of lines."""

from pathlib import Path
from typing import List, Tuple

from ceiling_dso_ros.io.errors import InputError


def read_lines(path: Path) -> List[Tuple[str, str]]:
    """The lines of a text file that are neither blank nor begin with #, stripped.

    Returns:
        Pairs of where the line is ("<path>, line 3"), for messages, and its text.

    Raises:
        InputError: the file cannot be read or is not a text.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise InputError(f"{path}: cannot read the file: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not a text file") from error
    numbered = ((f"{path}, line {number}", line.strip()) for number, line in enumerate(lines, start=1))
    return [(where, line) for where, line in numbered if line and not line.startswith("#")]
