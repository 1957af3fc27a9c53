# SPDX-License-Identifier: BSD-3-Clause
"""Structs of arrays as arguments of kernels.

numba 0.58 looks up the type of a named tuple by a fingerprint, and loses the beginning of a fingerprint longer than 40
bytes. So it does not find the type again: at every call it determines the type of every array anew, which takes a
quarter of a millisecond, and keeps the useless entry. A class decorated with `struct_of_arrays` gives numba its type
itself, once for all instances.
"""

from typing import Dict, NamedTuple, Type, TypeVar

import numpy as np
from numba import typeof, types
from numba.extending import typeof_impl

Struct = TypeVar("Struct", bound=NamedTuple)

_types: Dict[type, types.Type] = {}


def struct_of_arrays(struct: Type[Struct]) -> Type[Struct]:
    """Decorate a NamedTuple of C-contiguous arrays, or of such structs; fields keep their dtypes and dimensions."""
    del struct._asdict  # by which numba tells the named tuples that it looks up
    struct._numba_type_ = property(_type_of)  # type: ignore[attr-defined]  # which numba asks for
    typeof_impl.register(struct)(lambda value, context: _type_of(value))
    return struct


def _type_of(struct: NamedTuple) -> types.Type:
    """The type that kernels are compiled for.

    Raises:
        TypeError: an array is not C-contiguous.
    """
    kind = type(struct)
    for name, value in zip(kind._fields, struct):
        if not isinstance(value, np.ndarray):
            _type_of(value)
        elif not value.flags.c_contiguous:
            raise TypeError(f"{kind.__name__}.{name} is not C-contiguous: kernels would read past it")
    if kind not in _types:
        fields = [typeof(value) for value in struct]
        uniform = all(field == fields[0] for field in fields)
        _types[kind] = types.NamedUniTuple(fields[0], len(fields), kind) if uniform else types.NamedTuple(fields, kind)
    return _types[kind]
