"""Private parameters, read at start and refused in one line when they are wrong."""

import math
import os
from pathlib import Path
from typing import List, Optional, Sequence, Type, TypeVar

import rospy

from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.settings import load_settings

Config = TypeVar("Config")


def flag(name: str, default: bool) -> bool:
    """A parameter that is true or false.

    Raises:
        InputError: it is something else.
    """
    value = rospy.get_param(f"~{name}", default)
    if not isinstance(value, bool):
        raise InputError(f"{_resolved(name)}: '{value}' is not true or false")
    return value


def number(name: str, default: float, smallest: float, largest: float) -> float:
    """A parameter within a range, both ends included.

    Raises:
        InputError: it is no number or out of range.
    """
    value = rospy.get_param(f"~{name}", default)
    fits = isinstance(value, (int, float)) and not isinstance(value, bool) and smallest <= value <= largest
    if not fits or not math.isfinite(value):
        raise InputError(f"{_resolved(name)}: '{value}' is not a number of {smallest:g} to {largest:g}")
    return float(value)


def choice(name: str, default: str, choices: Sequence[str]) -> str:
    """A parameter that is one of a few words.

    Raises:
        InputError: it is another one.
    """
    value = rospy.get_param(f"~{name}", default)
    if value not in choices:
        raise InputError(f"{_resolved(name)}: '{value}' is not {' or '.join(choices)}")
    return value


def frame(name: str, default: str) -> str:
    """A tf frame, without a leading slash.

    Raises:
        InputError: it is no name.
    """
    value = rospy.get_param(f"~{name}", default)
    if not isinstance(value, str) or (default and not value.strip("/")):
        raise InputError(f"{_resolved(name)}: '{value}' is not the name of a frame")
    return value.lstrip("/")


def path(name: str) -> Optional[Path]:
    """A file or folder, None when the parameter is empty, as it is by default."""
    value = rospy.get_param(f"~{name}", "")
    return Path(value).expanduser() if value else None


def settings(kind: Type[Config]) -> Config:
    """The dataclass that the yaml file in `~settings` describes.

    Raises:
        InputError: the file cannot be read, or a value in it is wrong.
    """
    return load_settings(path("settings"), kind=kind)


def output_folder(name: str) -> Optional[Path]:
    """A folder that files can be written to, made if missing; None when the parameter is empty.

    Raises:
        InputError: it cannot be written to.
    """
    folder = path(name)
    if folder is not None:
        make_writable(folder)
    return folder


def make_writable(folder: Path) -> None:
    """Make a folder if it is missing.

    Raises:
        InputError: it cannot be made or written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot make this folder: {error.strerror}") from error
    if not os.access(folder, os.W_OK):
        raise InputError(f"{folder}: cannot write to this folder")


def joint_names() -> List[str]:
    """`~left_joint` and `~right_joint`; left and right are found by these words in them by default."""
    return [str(rospy.get_param(f"~{side}_joint", "")) for side in ("left", "right")]


def _resolved(name: str) -> str:
    return rospy.resolve_name(f"~{name}")
