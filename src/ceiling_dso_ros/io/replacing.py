# SPDX-License-Identifier: BSD-3-Clause
"""Files that are replaced only when they are complete."""

from pathlib import Path
from typing import Union

from ceiling_dso_ros.io.errors import OutputError


def replace_file(path: Union[str, Path], content: bytes, what: str) -> None:
    """Write a file; an older one is replaced only when the new one is complete.

    Args:
        what: the content in words, for the message.

    Raises:
        OutputError: the file cannot be written.
    """
    path = Path(path)
    temporary = path.with_name(path.name + ".part")
    try:
        temporary.write_bytes(content)
        temporary.replace(path)
    except OSError as error:
        raise OutputError(f"{path}: cannot write {what}: {error.strerror}") from error
