# SPDX-License-Identifier: BSD-3-Clause
"""Files that are written whole or not at all: an older one is replaced when the new one is complete."""

import os
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, Iterator, Union

from ceiling_dso_ros.io.errors import OutputError, reason_of


@contextmanager
def replacing(path: Union[str, Path], what: str) -> Iterator[BinaryIO]:
    """Open a new file beside the one to be replaced, which happens at the end of the block; on errors it is removed.

    Args:
        path: of the file.
        what: the content in words, for the message.

    Raises:
        OutputError: the file cannot be written.
    """
    path = Path(path)
    temporary = path.with_name(path.name + ".part")
    try:
        with temporary.open("wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())  # some file systems find out only now that they are full
        temporary.replace(path)
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
