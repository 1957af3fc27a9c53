# SPDX-License-Identifier: BSD-3-Clause
"""What holds for every input, whatever is in it.

An input may be refused with one of the package's own errors, whose message is one clear line. It may not end in another
error, and what comes of it must be finite.
"""

import dataclasses
import math
from pathlib import Path
from typing import Any, Callable, Mapping, Tuple

import numpy as np

from ceiling_dso_ros.dso.config import ConfigError
from ceiling_dso_ros.io.errors import LONGEST_MESSAGE, FrameError, InputError, OutputError

USED, REFUSED = "used", "refused"
UNCLEAR = ("Traceback", "MemoryError", "allocate", "-X dev", "NoneType", "recursion", "object has no attribute")


class BrokenRuleError(Exception):
    """What happened with an input is against the rules."""


def outcome_of(read: Callable[[], object]) -> str:
    """Read an input: USED or REFUSED.

    Raises:
        BrokenRuleError: the result is not finite, or the message of the error is not one clear line.
    """
    try:
        result = read()
    except (ConfigError, InputError, FrameError, OutputError) as error:
        require_clear_line(str(error))
        return REFUSED
    require_finite(result)
    return USED


def require_clear_line(text: str) -> None:
    """Raise BrokenRuleError unless a text is one line of bounded length that tells of no error of Python."""
    if not text or not text.isprintable() or len(text) > LONGEST_MESSAGE:
        raise BrokenRuleError(f"not one line: {text[-900:]!r}")
    for words in UNCLEAR:
        if words in text:
            raise BrokenRuleError(f"not clear: {text[:500]}")


def require_finite(value: Any, name: str = "the result", unknown: Tuple[str, ...] = ()) -> None:  # noqa: ANN401
    """Raise BrokenRuleError if a number in a value, at any depth, is not finite.

    Args:
        value: numbers, arrays, dataclasses, messages of ROS, and collections of them; anything else has no numbers.
        name: of it, for the message.
        unknown: names of fields in which NaN stands for a number that is not known.
    """
    if isinstance(value, (float, np.floating)):
        if not math.isfinite(value):
            raise BrokenRuleError(f"{name} is {value}")
    elif isinstance(value, np.ndarray):
        if value.dtype.kind == "f" and not np.isfinite(value).all():
            raise BrokenRuleError(f"{name} has numbers that are not finite")
    elif isinstance(value, Mapping):
        for key, member in value.items():
            require_finite(member, f"{name}[{key!r}]", unknown)
    elif isinstance(value, (list, tuple)):
        for member in value:
            require_finite(member, name, unknown)
    else:
        for field in _field_names(value):
            if field not in unknown:
                require_finite(getattr(value, field), f"{name}.{field}", unknown)


def require_finite_files(folder: Path) -> None:
    """The same for trajectories and summaries that were written to a folder."""
    for path in folder.rglob("*"):
        if path.suffix in (".tum", ".json", ".yaml", ".csv"):
            words = path.read_text().replace(",", " ").replace(":", " ").split()
            for word in words:
                if word.strip("[]{}\"'").lower() in ("nan", "inf", "-inf", ".nan", ".inf", "-.inf", "infinity"):
                    raise BrokenRuleError(f"{path.name} has a number {word}")


def _field_names(value: object) -> Tuple[str, ...]:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return tuple(field.name for field in dataclasses.fields(value))
    is_message = hasattr(value, "_slot_types")
    return tuple(getattr(value, "__slots__", ())) if is_message else ()
