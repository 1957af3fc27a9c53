# SPDX-License-Identifier: BSD-3-Clause
"""Wrong messages, as any node can send them and any recorder can write them: each field has a value of its type."""

import copy
from random import Random
from typing import Any, Callable, Dict, List, NamedTuple

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import get_types_from_msg
from support.checkout import CHECKOUT
from support.fuzzing import mutations

from ceiling_dso_ros.io.ros_messages import TYPES, RosMessage

PACKAGE = "ceiling_dso_ros"
LONGEST_ARRAY = 300
MOST_EDITS = 4


def _register_own_messages() -> None:
    """Those that the package reads from no bag, and so does not know there."""
    own = {
        f"{PACKAGE}/msg/{path.stem}": path.read_text()
        for path in sorted((CHECKOUT / "msg").glob("*.msg"))
        if f"{PACKAGE}/msg/{path.stem}" not in TYPES.FIELDDEFS
    }
    found: Dict[str, Any] = {}
    for name, definition in own.items():
        found.update(get_types_from_msg(definition, name))
    TYPES.register(found)


class _Place(NamedTuple):
    """A field in a message, at any depth: what holds it, its name or index, and the type of it."""

    owner: Any
    key: Any
    kind: Nodetype
    what: Any


def mutated_message(random: Random, message: RosMessage) -> RosMessage:
    """Some fields of a message changed."""
    changed = copy.deepcopy(message)
    for _ in range(mutations.edits(random, MOST_EDITS)):
        places = _places(changed, changed.__msgtype__)
        _edit(random, random.choice(places))
    return changed


def serialised(message: RosMessage) -> bytes:
    """The bytes of a message, as a bag or a connection has them."""
    return bytes(TYPES.serialize_ros1(message, message.__msgtype__))


def mutated_lengths(random: Random, message: RosMessage) -> bytes:
    """The bytes of a message of which some are others."""
    return mutations.mutated_bytes(random, serialised(message), most=3)


def _places(owner: Any, message_type: str) -> List[_Place]:  # noqa: ANN401
    places = []
    fields: Any = TYPES.get_msgdef(message_type).fields  # what a field holds depends on its kind
    for name, (kind, what) in fields:
        member = getattr(owner, name, None)
        if kind is Nodetype.NAME:
            places += _places(member, what)
            continue
        places.append(_Place(owner, name, kind, what))
        if kind in (Nodetype.SEQUENCE, Nodetype.ARRAY) and what[0][0] is Nodetype.NAME:
            for element in member or ():
                places += _places(element, what[0][1])
    return places


def _edit(random: Random, place: _Place) -> None:
    owner, name, kind, what = place
    before = getattr(owner, name)
    if kind is Nodetype.BASE:
        setattr(owner, name, _base_value(random, what[0]))
        return
    element_kind, element = what[0]
    if element_kind is Nodetype.NAME:
        setattr(owner, name, _edited_list(random, list(before), lambda: random.choice(list(before))))
    elif element[0] == "string":
        setattr(owner, name, _edited_list(random, list(before), lambda: _base_value(random, "string")))
    else:
        after = np.array(before)
        if kind is Nodetype.SEQUENCE and random.randrange(2):
            length = random.choice((0, 1, max(len(after) - 1, 0), len(after) + 1, LONGEST_ARRAY))
            after = np.resize(after, length) if len(after) else np.zeros(length, after.dtype)
        if len(after):
            after[random.randrange(len(after))] = _base_value(random, element[0])
        setattr(owner, name, after)


def _edited_list(random: Random, members: List[Any], new: Callable[[], Any]) -> List[Any]:
    kind = random.randrange(5)
    if not members:
        return members
    at = random.randrange(len(members))
    if kind == 0:
        del members[at]
    elif kind == 1:
        members.insert(at, copy.deepcopy(members[random.randrange(len(members))]))
    elif kind == 2:
        members[at] = copy.deepcopy(new())
    elif kind == 3:
        members.reverse()
    else:
        members = members[:at]
    return members


def _base_value(random: Random, kind: str) -> Any:  # noqa: ANN401
    if kind == "string":
        return mutations.text(random)
    if kind == "bool":
        return bool(random.randrange(2))
    if kind == "float64":
        return mutations.number(random)
    if kind == "float32":
        return float(np.clip(mutations.number(random), -3e38, 3e38))
    limits = np.iinfo({"byte": "int8", "char": "uint8"}.get(kind, kind))
    fitting = [number for number in mutations.INTEGERS if limits.min <= number <= limits.max]
    return random.choice(fitting)


_register_own_messages()
