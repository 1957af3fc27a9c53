# SPDX-License-Identifier: BSD-3-Clause
"""Makes wrong inputs of valid ones: of bytes, of texts, and of nested values."""

import copy
import re
from random import Random
from typing import Any, List, Sequence, Tuple, Union

NAN, INF = float("nan"), float("inf")
NUMBERS = (
    *(
        NAN,
        INF,
        -INF,
        0.0,
        -0.0,
        -1.0,
        1.0,
        1e308,
        -1e308,
        1e155,
        5e-324,
        1e-160,
        1e-30,
        1e-9,
        0.5,
        10.0,
        1e3,
        1e8,
        1e9,
    ),
    *(2.0**31, 2.0**53, 1e18, 1e20, 1e38, -1e38),
)
INTEGERS = (0, 1, -1, 2, 7, 255, 65_535, 10**6, 2**31 - 1, -(2**31), 2**32 - 1, 2**63 - 1, -(2**63), 2**64, 10**30)
TEXTS = (
    *("", " ", "nan", "-inf", "1e999", "0x10", "1_000", "\u00e9", "\U0001f600", "\x00", "a\nb", "\x1b[31m", "\u2028"),
    *("../../etc/passwd", "/dev/zero", "${x}", "???", "*a", "&a", "-", "true", "null", "~", "2001-13-45", "deg(90)"),
    *(
        "deg(x)",
        "deg()",
        "1e-999999999",
        "0e999999999",
        "9" * 400,
        "x" * 5000,
        "\u0663",
        "[" * 200,
        "!!python/name:os.system",
    ),
    *("Pinhole", "FOV", "crop", "full", "none", "1:60:60", "0b2", "<<", "\ufeff", "-0", "+1", ".5", "5.", "1e5", "1,2"),
)
LENGTHS = (0, 1, 4, 255, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFC, 0xFFFFFFFF)  # of four bytes
WORDS = re.compile(r"[^\s,:\[\]{}]+|[\s,:\[\]{}]")

Path = Tuple[Union[str, int], ...]


def number(random: Random) -> float:
    """A number that is likely to break something."""
    return random.choice(NUMBERS) if random.randrange(4) else random.uniform(-10.0, 10.0)


def text(random: Random) -> str:
    """The same of a text."""
    return random.choice(TEXTS)


def value(random: Random) -> Any:  # noqa: ANN401
    """The same of anything that yaml can say."""
    kind = random.randrange(6)
    if kind == 0:
        return random.choice(INTEGERS)
    if kind == 1:
        return number(random)
    if kind == 2:
        return text(random)
    if kind == 3:
        return [value(random) for _ in range(random.randrange(4))]
    if kind == 4:
        return {text(random): value(random) for _ in range(random.randrange(3))}
    return random.choice((None, True, False))


def edits(random: Random, most: int) -> int:
    """How many edits: one for half of the inputs, because what is checked first hides what comes later."""
    return 1 if random.randrange(2) else 1 + random.randrange(most)


def mutated_bytes(random: Random, data: bytes, most: int = 6) -> bytes:
    """Some places of the bytes changed, cut out, repeated, or declaring another length."""
    changed = bytearray(data)
    for _ in range(edits(random, most)):
        start = random.randrange(len(changed) + 1)
        kind = random.randrange(7)
        if kind == 0:
            changed[start : start + 1] = bytes([random.randrange(256)])
        elif kind == 1:
            order = random.choice(("little", "big"))
            changed[start : start + 4] = random.choice(LENGTHS).to_bytes(4, order)  # type: ignore[arg-type]
        elif kind == 2:
            del changed[start : start + 1 + random.randrange(16)]
        elif kind == 3:
            changed[start:start] = changed[start : start + 1 + random.randrange(64)]
        elif kind == 4:
            changed[start:start] = bytes(random.randrange(256) for _ in range(random.randrange(8)))
        elif kind == 5:
            changed[start : start + 1] = bytes(
                [changed[start] ^ (1 << random.randrange(8))] if start < len(changed) else []
            )
        elif not random.randrange(4):
            del changed[start:]
    return bytes(changed)


def mutated_text(random: Random, original: str, most: int = 4) -> str:
    """Some words and lines of a text changed, left out, repeated or moved."""
    changed = original
    for _ in range(edits(random, most)):
        if random.randrange(3):
            changed = "".join(_edited(random, WORDS.findall(changed)))
        else:
            changed = "".join(_edited(random, changed.splitlines(keepends=True)))
    return changed


def mutated_text_bytes(random: Random, original: str) -> bytes:
    """A text changed as such, or in its bytes."""
    if random.randrange(5):
        return mutated_text(random, original).encode("utf-8", "surrogatepass")
    return mutated_bytes(random, original.encode())


def _edited(random: Random, parts: Sequence[str]) -> List[str]:
    edited = list(parts)
    if not edited:
        return [text(random)]
    at, kind = random.randrange(len(edited)), random.randrange(8)
    if kind >= 6:
        edited[at] = _changed_number(random, edited[at])
    elif kind == 0:
        del edited[at]
    elif kind == 1:
        edited.insert(at, edited[random.randrange(len(edited))])
    elif kind == 2:
        other = random.randrange(len(edited))
        edited[at], edited[other] = edited[other], edited[at]
    elif kind == 3:
        edited[at] = repr(number(random))
    elif kind == 4:
        edited[at] = str(random.choice(INTEGERS))
    else:
        edited[at] = text(random)
    return edited


def _changed_number(random: Random, word: str) -> str:
    try:
        return repr(float(word) * random.choice((-1.0, 0.5, 0.99, 1.01, 2.0, 100.0)))
    except ValueError:
        return word


def mutated_tree(random: Random, original: Any, most: int = 3) -> Any:  # noqa: ANN401
    """Some members of nested mappings and lists changed, left out, repeated or renamed."""
    tree = copy.deepcopy(original)
    for _ in range(edits(random, most)):
        paths = _paths(tree, ())
        path = random.choice(paths)
        if not path:
            continue
        parent = tree
        for key in path[:-1]:
            parent = parent[key]
        _edit_member(random, parent, path[-1])
    return tree


def _edit_member(random: Random, parent: Any, key: Union[str, int]) -> None:  # noqa: ANN401
    kind = random.randrange(6)
    if kind == 0:
        del parent[key]
    elif kind == 1 and isinstance(parent, list):
        parent.append(copy.deepcopy(parent[key]))  # type: ignore[index]
    elif kind == 1:
        parent[text(random)] = parent.pop(key)
    elif kind == 2:
        parent[key] = number(random)
    else:
        parent[key] = value(random)


def _paths(tree: Any, path: Path) -> List[Path]:  # noqa: ANN401
    members = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    return [path, *(below for key, member in members for below in _paths(member, (*path, key)))]
