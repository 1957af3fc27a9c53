# SPDX-License-Identifier: BSD-3-Clause
"""The folder that a command writes into."""

from contextlib import contextmanager
from pathlib import Path
from typing import Iterator

from ceiling_dso_ros.io.errors import InputError, reason_of


@contextmanager
def output_folder(folder: Path) -> Iterator[Path]:
    """Create a folder if it is missing, for the files that the with block writes.

    Raises:
        InputError: it cannot be made, or the block cannot write.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield folder
    except OSError as error:
        raise InputError(f"{folder}: cannot write there: {reason_of(error)}; choose another --out") from error
