# SPDX-License-Identifier: BSD-3-Clause
"""Reads private parameters once at start, rejects wrong ones with one line, and writes all values back."""

import os
from pathlib import Path
from typing import Any, Dict, Iterable, Mapping, Optional, Tuple

import rospy

from ceiling_dso_ros.io.errors import InputError, OutputError
from ceiling_dso_ros.io.known_names import all_names, require_known
from ceiling_dso_ros.io.replacing import require_writable
from ceiling_dso_ros.playback.spool_files import require_outside_spools
from ceiling_dso_ros.settings import default_values, merge_settings, plain_values


def read(*kinds: type, groups: Optional[Mapping[str, Any]] = None) -> Tuple[Any, ...]:
    """Read this node's private parameters into dataclasses.

    Parameters that are not set have their defaults. All values are then written to the parameter server, so that it
    shows the values that the node uses.

    Args:
        kinds: dataclasses as for `merge_settings`; their names are on the same level.
        groups: nested names of further groups that are read elsewhere.

    Returns:
        One object for each of kinds.

    Raises:
        InputError: a name is unknown, a value of another type or out of range, or the node's name itself has a value.
    """
    node, given = rospy.get_name(), rospy.get_param("~", {})
    if not isinstance(given, dict):
        raise InputError(
            f"{node}: holds one value, {given!r}, instead of parameters; remove it: rosparam delete {node}"
        )
    defaults = {name: value for kind in kinds for name, value in default_values(kind).items()}
    # The further groups are checked where they are read.
    known = {**defaults, **{name: given.get(name, names) for name, names in (groups or {}).items()}}
    try:
        require_known(given, known, node)
        found = tuple(_merge(kind, given, node) for kind in kinds)
    except InputError as error:
        raise InputError(_with_slashes(str(error), [*all_names(known), *all_names(given)])) from error
    for config in found:
        write(plain_values(config), given)
    return found


def write(values: Mapping[str, Any], given: Mapping[str, Any]) -> None:
    """Set private parameters that have another value or none."""
    for name, value in values.items():
        if name not in given or repr(given[name]) != repr(value):  # 1 is 1.0, and True is 1
            rospy.set_param(f"~{name}", value)


def _merge(kind: type, given: Mapping[str, Any], node: str) -> Any:  # noqa: ANN401
    values = {name: given[name] for name in default_values(kind) if name in given}
    return merge_settings(kind, [(node, values)], node)


def _with_slashes(message: str, names: Iterable[str]) -> str:
    """ROS has slashes where settings have dots."""
    dotted: Dict[str, str] = {name: name.replace(".", "/") for name in names if "." in name}
    for name in sorted(dotted, key=len, reverse=True):
        message = message.replace(name, dotted[name])
    return message


def file_path(value: str) -> Optional[Path]:
    """A file or folder, None for an empty text.

    Raises:
        InputError: no file can have this name, or it begins with the home of a user who is unknown.
    """
    if not value:
        return None
    try:
        if b"\0" in os.fsencode(value):
            raise InputError(f"{value!r}: no file has a NUL in its name")
        return Path(value).expanduser()
    except UnicodeEncodeError as error:
        raise InputError(f"{value!r}: no name of a file: {error.reason}") from error
    except RuntimeError as error:
        raise InputError(f"{value}: this home is unknown: {error}") from error


def output_folder(value: str) -> Optional[Path]:
    """A folder that files can be written to, made if missing; None for an empty parameter.

    Raises:
        InputError: it is no path, or cannot be written to.
    """
    folder = file_path(value)
    if folder is not None:
        make_writable(folder)
    return folder


def make_writable(folder: Path) -> None:
    """Make a folder if it is missing.

    Raises:
        InputError: it cannot be made or written to, or is where a node keeps its results.
    """
    require_outside_spools(folder)
    try:
        require_writable(folder)
    except OutputError as error:
        raise InputError(str(error)) from error
