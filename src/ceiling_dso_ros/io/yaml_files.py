# SPDX-License-Identifier: BSD-3-Clause
"""Yaml files with settings: plain values only, never objects of Python, and never more than a file with settings needs.

References (&name, *name, <<) are allowed, but nine lines of them can stand for a billion values.
"""

from pathlib import Path
from typing import Any, Dict, Set

import yaml

from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.limits import MOST_SETTINGS
from ceiling_dso_ros.io.text_files import read_text


def read_yaml(path: Path) -> Any:  # noqa: ANN401
    """The content of a yaml file, None of an empty one.

    Raises:
        InputError: the file cannot be read, is no yaml with plain values, contains a name twice, or too many values.
    """
    text = read_text(path)
    try:
        return _plain_values(text)
    except RecursionError:
        raise InputError(f"{path}: is not valid yaml: too deeply nested") from None
    except Exception as error:  # of any kind: dates and numbers that are none are errors of Python
        raise InputError(f"{path}: is not valid yaml: {' '.join(str(error).split())}") from error


def _plain_values(text: str) -> Any:  # noqa: ANN401
    loader = yaml.SafeLoader(text)
    try:
        document = loader.get_single_node()
        if document is None:
            return None
        _require_small(document)
        return loader.construct_document(document)  # type: ignore[no-untyped-call]
    finally:
        loader.dispose()  # type: ignore[no-untyped-call]


def _require_small(document: yaml.Node) -> None:
    """Raise ValueError for a name that is there twice, or for too many values with all references resolved."""
    sizes: Dict[int, int] = {}  # of the nodes that are complete
    pending: Set[int] = set()

    def size_of(node: yaml.Node) -> int:
        if id(node) in sizes:
            return sizes[id(node)]
        if id(node) in pending:
            raise ValueError("a value contains itself")
        pending.add(id(node))
        size = 1
        if isinstance(node, yaml.MappingNode):
            _require_different_names(node)
            size += sum(size_of(part) for pair in node.value for part in pair)
        elif isinstance(node, yaml.SequenceNode):
            size += sum(map(size_of, node.value))
        if size > MOST_SETTINGS:
            raise ValueError(f"more than {MOST_SETTINGS} values")
        sizes[id(node)] = size
        return size

    size_of(document)


def _require_different_names(node: yaml.MappingNode) -> None:
    names: Set[str] = set()
    for name, _ in node.value:
        if isinstance(name, yaml.ScalarNode):
            if name.value in names:
                raise ValueError(f"{name.value} is there twice, again in line {name.start_mark.line + 1}")
            names.add(name.value)
