# SPDX-License-Identifier: BSD-3-Clause
"""Files that are written whole or not at all: an older one is replaced when the new one is complete."""

import os
import tempfile
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, Callable, Iterable, Iterator, List, Mapping, Union

from ceiling_dso_ros.io.errors import InputError, OutputError, reason_of

TRIED_BYTES = 4096  # an empty file fits on a disk that is full


@contextmanager
def replacing(path: Union[str, Path], what: str) -> Iterator[BinaryIO]:
    """Open a new file beside the one to be replaced, which happens at the end of the block; on errors it is removed.

    A link stays, and what it leads to is replaced. What is no file at all, such as /dev/null, is written to.

    Args:
        path: of the file.
        what: the content in words, for the message.

    Raises:
        OutputError: the file cannot be written.
    """
    goal = Path(os.path.realpath(path))
    temporary = goal.with_name(goal.name + ".part")
    try:
        if goal.exists() and not (goal.is_file() or goal.is_dir()):
            with goal.open("wb") as file:
                yield file
            return
        with temporary.open("wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())  # some file systems find out only now that they are full
        temporary.replace(goal)
    except OSError as error:
        raise OutputError(f"{path}: cannot write {what}: {reason_of(error)}") from error
    finally:
        with suppress(OSError):  # it has its name now, or there was never any
            temporary.unlink()


def replace_file(path: Union[str, Path], content: bytes, what: str) -> None:
    """Write a file; an older one is replaced only when the new one is complete.

    Args:
        path: of the file.
        content: all of it.
        what: the content in words, for the message.

    Raises:
        OutputError: the file cannot be written.
    """
    with replacing(path, what) as file:
        file.write(content)


def write_each(directory: Path, writers: Mapping[str, Callable[[Path], object]]) -> None:
    """Write several files; what is wrong with one does not stop the others.

    Args:
        directory: an existing folder.
        writers: name of a file -> writes it to a path, whole or not at all.

    Raises:
        OutputError: a file cannot be computed or written; all the others are written.
    """
    lines: List[str] = []
    for name, write in writers.items():
        path = directory / name
        try:
            write(path)
        except OutputError as error:
            lines += error.lines
        except InputError as error:
            lines.append(str(error))
        except Exception as error:
            lines.append(f"{path}: cannot compute what belongs there: {type(error).__name__}: {error}")
    if lines:
        raise OutputError(*lines)


def require_writable(directory: Path, names: Iterable[str] = ()) -> None:
    """Try whether files can be written, before the work whose results they are to hold.

    Args:
        directory: a folder, made if it is missing.
        names: of the files.

    Raises:
        OutputError: the folder cannot be made or written to, there is no space, or a folder has the name of a file.
    """
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=directory) as file:
            file.write(bytes(TRIED_BYTES))
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise OutputError(f"{directory}: cannot write there: {reason_of(error)}") from error
    for name in names:
        if (directory / name).is_dir():
            raise OutputError(f"{directory / name}: cannot write the file: Is a directory")
