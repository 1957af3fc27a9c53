# SPDX-License-Identifier: BSD-3-Clause
"""What a command writes: it is tried before the work begins, and what could not be written at the end is said."""

import sys
from pathlib import Path
from typing import Iterable, Optional

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


def require_output_file(path: Path, names_beside: Iterable[str] = (), inputs: Iterable[Optional[Path]] = ()) -> None:
    """Try whether a file, and others in its folder, can be written; the folder must exist.

    Args:
        path: the file.
        names_beside: of the others.
        inputs: what the command reads, files and folders of recordings; None is nothing.

    Raises:
        InputError: they cannot, or one of them is read by the command.
    """
    names_beside = list(names_beside)
    for read in inputs:
        for output in (path, *(path.with_name(name) for name in names_beside)):
            if read is not None and _is_part_of(output, read):
                raise InputError(f"{output}: is what the command reads; choose another --out")
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no folder {path.parent}; choose another --out")
    if not path.exists() or path.is_file() or path.is_dir():  # else it is a device or a pipe
        require_output_folder(path.parent, [path.name, *names_beside])


def require_names_as_text(names: Iterable[object]) -> None:
    """Check paths that are written to files, whose texts are UTF-8.

    Raises:
        InputError: the name of one is not.
    """
    for name in names:
        try:
            str(name).encode()
        except UnicodeEncodeError as error:
            raise InputError(f"{name}: the name is not UTF-8, which a text needs that has it: rename it") from error


def _is_part_of(output: Path, read: Path) -> bool:
    """Whether an output would replace an input, or a file of a recording that is a folder."""
    from ceiling_dso_ros.io.tum_folder import FILES  # slow to import

    resolved, inside = output.resolve(), read.resolve()
    if resolved.exists() and inside.is_dir():
        return resolved.parent == inside and resolved.name in FILES
    return resolved == inside


def complain(message: str) -> None:
    """One line on stderr."""
    print(one_line(f"error: {' '.join(message.split())}"), file=sys.stderr)
