# SPDX-License-Identifier: BSD-3-Clause
"""Checks the lengths that a serialised ROS 1 message declares, before it is deserialised.

rosbags believes them: a string of negative length makes it read the same bytes again, for each of two billion names of
a message of 20 bytes.
"""

import struct
from functools import lru_cache
from typing import Any, Optional

from rosbags.interfaces import Nodetype
from rosbags.serde.utils import SIZEMAP

from ceiling_dso_ros.io.ros_messages import TYPES

LENGTH = struct.Struct("<I")
STRING = "string"
OF_NO_FIELDS = "structure_needs_at_least_one_member"  # takes no bytes in ROS 1


def check_lengths(data: bytes, message_type: str) -> None:
    """Raise ValueError unless data has exactly the length that it declares for a message of this type."""
    end = _after_message(data, 0, message_type)
    if end != len(data):
        raise ValueError(f"the message ends after {end} of {len(data)} bytes")


def _after_message(data: bytes, position: int, message_type: str) -> int:
    size = _fixed_size(message_type)
    if size is not None:
        return _within(data, position + size)
    for _, (kind, what) in TYPES.get_msgdef(message_type).fields:
        position = _after(data, position, kind, what)
    return position


def _after(data: bytes, position: int, kind: Nodetype, what: Any) -> int:  # noqa: ANN401 a tree of tuples
    """Where a field ends that begins at a position."""
    if kind is Nodetype.NAME:
        return _after_message(data, position, what)
    if kind is Nodetype.BASE:
        if what[0] != STRING:
            return _within(data, position + SIZEMAP[what[0]])
        return _within(data, position + LENGTH.size + _length(data, position))
    element_kind, element = what[0]
    count = what[1]
    if kind is Nodetype.SEQUENCE:
        count = _length(data, position)
        position += LENGTH.size
    size = _fixed_size_of(element_kind, element)
    if size is not None:
        return _within(data, position + count * size)
    for _ in range(count):  # each takes four bytes at least, so this ends with the data
        position = _after(data, position, element_kind, element)
    return position


def _length(data: bytes, position: int) -> int:
    length: int = LENGTH.unpack_from(data, _within(data, position + LENGTH.size) - LENGTH.size)[0]
    return length


def _within(data: bytes, position: int) -> int:
    if position > len(data):
        raise ValueError(f"the message declares more than its {len(data)} bytes")
    return position


@lru_cache(maxsize=None)
def _fixed_size(message_type: str) -> Optional[int]:
    """Bytes of any message of a type; None where they are not always the same."""
    fields = TYPES.get_msgdef(message_type).fields
    sizes = [_fixed_size_of(kind, what) for name, (kind, what) in fields if name != OF_NO_FIELDS]
    return None if None in sizes else sum(size for size in sizes if size is not None)


def _fixed_size_of(kind: Nodetype, what: Any) -> Optional[int]:  # noqa: ANN401
    if kind is Nodetype.NAME:
        return _fixed_size(what)
    if kind is Nodetype.BASE:
        return None if what[0] == STRING else SIZEMAP[what[0]]
    if kind is Nodetype.ARRAY:
        size = _fixed_size_of(*what[0])
        return None if size is None else what[1] * size
    return None
