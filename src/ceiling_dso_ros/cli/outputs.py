# SPDX-License-Identifier: BSD-3-Clause
"""What a command writes: it is tried before the work begins, and what could not be written at the end is said."""

import sys
from pathlib import Path
from typing import Iterable

from ceiling_dso_ros.io.errors import InputError, OutputError, one_line
from ceiling_dso_ros.io.replacing import require_writable


def require_output_folder(folder: Path, names: Iterable[str] = ()) -> None:
    """Make a folder if it is missing, and try whether files with these names can be written to it.

    Raises:
        InputError: they cannot, or a node keeps its results there.
    """
    from ceiling_dso_ros.playback.spool_files import require_outside_spools  # slow to import

    require_outside_spools(folder)
    try:
        require_writable(folder, names)
    except OutputError as error:
        raise InputError(f"{error}; choose another --out") from error


def require_output_file(path: Path, names_beside: Iterable[str] = ()) -> None:
    """Try whether a file, and others in its folder, can be written; the folder must exist.

    Raises:
        InputError: they cannot.
    """
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no folder {path.parent}; choose another --out")
    if not path.exists() or path.is_file() or path.is_dir():  # else it is a device or a pipe
        require_output_folder(path.parent, [path.name, *names_beside])


def complain(message: str) -> None:
    """One line on stderr."""
    print(one_line(f"error: {' '.join(message.split())}"), file=sys.stderr)
