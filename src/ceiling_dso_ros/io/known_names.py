# SPDX-License-Identifier: BSD-3-Clause
"""Rejects unknown names: otherwise a misspelt setting would be ignored without a message."""

from difflib import get_close_matches
from typing import Any, Iterator, Mapping

from ceiling_dso_ros.io.errors import InputError


def require_known(values: Mapping, known: Mapping, source: str) -> None:
    """Check all names of nested values.

    Args:
        values: names and values as given; a mapping among the values is a group.
        known: the known names, with the same nesting; an entry that is not a mapping stands for any value.
        source: file or node of the values, for the message.

    Raises:
        InputError: a name is unknown (the message suggests the nearest one), or a group has a value.
    """
    for name in _unknown(values, known, ""):
        nearest = get_close_matches(name, list(all_names(known)), n=1)
        advice = f"did you mean {nearest[0]}?" if nearest else f"there are {', '.join(known)}"
        raise InputError(f"{source}: {name} is unknown; {advice}")
    for name, group in known.items():
        if isinstance(group, Mapping) and not isinstance(values.get(name, {}), Mapping):
            raise InputError(f"{source}: {name} is a group of values, not one: {', '.join(group)}")


def all_names(known: Mapping, prefix: str = "") -> Iterator[str]:
    """All names with dots between group and member, each group before its members."""
    for name, value in known.items():
        yield f"{prefix}{name}"
        if isinstance(value, Mapping):
            yield from all_names(value, f"{prefix}{name}.")


def _unknown(values: Mapping, known: Mapping, prefix: str) -> Iterator[str]:
    for key, value in values.items():
        name = f"{prefix}{key}"
        members = known.get(key)
        if isinstance(value, Mapping) and isinstance(members, Mapping):
            yield from _unknown(value, members, f"{name}.")
        elif isinstance(value, Mapping) or key not in known:
            yield _first_member(name, value)


def _first_member(name: str, value: Any) -> str:  # noqa: ANN401
    """The first member of an unknown group, so that the nearest name is searched among full names."""
    while isinstance(value, Mapping) and value:
        key, value = next(iter(value.items()))
        name = f"{name}.{key}"
    return name
