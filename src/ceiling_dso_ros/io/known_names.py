"""Refuses names that nobody reads: a misspelt setting would otherwise be ignored in silence."""

from difflib import get_close_matches
from typing import Any, Iterator, Mapping

from ceiling_dso_ros.io.errors import InputError


def require_known(values: Mapping, known: Mapping, source: str) -> None:
    """Check all names of nested values.

    Args:
        values: names and values as given; a mapping among the values is a group.
        known: the names that there are, nested likewise; what is no mapping here is a value of any kind.
        source: names the file or node that they come from, for the message.

    Raises:
        InputError: there is no such name, the message has the nearest one; or a group has a value.
    """
    for name in _unknown(values, known, ""):
        nearest = get_close_matches(name, list(all_names(known)), n=1)
        advice = f"did you mean {nearest[0]}?" if nearest else f"there are {', '.join(known)}"
        raise InputError(f"{source}: {name} is unknown; {advice}")
    for name, group in known.items():
        if isinstance(group, Mapping) and not isinstance(values.get(name, {}), Mapping):
            raise InputError(f"{source}: {name} is a group of values, not one: {', '.join(group)}")


def all_names(known: Mapping, prefix: str = "") -> Iterator[str]:
    """All names with dots between group and member, groups before what is in them."""
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
    """Of an unknown group, so that the nearest name is looked for with all that is known."""
    while isinstance(value, Mapping) and value:
        key, value = next(iter(value.items()))
        name = f"{name}.{key}"
    return name
