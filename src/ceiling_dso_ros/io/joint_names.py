# SPDX-License-Identifier: BSD-3-Clause
"""What the names of joints say: which of them are the wheels of a base, and on which side."""

import re
from typing import Dict, FrozenSet, Iterable, List, NamedTuple, Optional, Tuple

WORDS = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")
GLUED = re.compile(r"(left|right|^[lr](?=wheel|whl))")  # leftwheel, lwheel
SIDES = {"l": "left", "left": "left", "r": "right", "right": "right"}
AXLES = {"f": "front", "m": "middle", "r": "rear", "b": "rear"}  # fl is the front left one, rr the rear right one
POSITIONS = {"front", "middle", "mid", "center", "centre", "rear", "back"}
WHEELS = ("wheel", "whl", "tire", "tyre")
# Parts of wheels that do not drive, and parts that are named after a wheel without being one.
NO_WHEELS = (
    *("caster", "castor", "swivel", "steer", "pivot", "suspension", "shock", "spring", "rocker", "bogie"),
    *("gripper", "finger", "hand", "arm", "lift", "fly"),
)
# A name without the word wheel may have these and no others, because any other may be that of another part.
PLAIN_WORDS = {"joint", "motor", "drive", "base", "encoder", "hub", "axle", "shaft", "track", "hinge", "link"}


class JointPair(NamedTuple):
    """Names of a left and a right joint."""

    left: str
    right: str

    def __str__(self) -> str:
        return f"{self.left} and {self.right}"


class JointName(NamedTuple):
    """A joint's name in parts.

    Attributes:
        side: left or right, None where the name says neither or both.
        words: the others in small letters; those of two wheels of an axle are the same.
    """

    side: Optional[str]
    words: Tuple[str, ...]

    @property
    def place(self) -> FrozenSet[str]:
        """The words that say where on its side the joint is."""
        return frozenset(word for word in self.words if word in POSITIONS or word.isdigit())

    @property
    def is_wheel(self) -> bool:
        """The name says that it is a wheel that drives."""
        named = any(wheel in word for word in self.words for wheel in WHEELS)
        return named and not any(word.startswith(NO_WHEELS) for word in self.words)

    @property
    def is_plain(self) -> bool:
        """The name says no more than side and place."""
        return all(word in PLAIN_WORDS or word in POSITIONS for word in self.words)


def parse_joint_name(name: str) -> JointName:
    """The parts of a name such as front_left_wheel, wheelLeft, l_wheel_joint or rr_wheel."""
    sides, rest = set(), []
    glued = [part for word in WORDS.findall(name) for part in GLUED.split(word.lower()) if part]
    for word in glued:
        axle, side = (word[0], word[1]) if len(word) == 2 else ("", word)
        if axle in SIDES and side in AXLES and side not in SIDES:  # lf is fl
            axle, side = side, axle
        if axle == "l" and side == "r":  # the left rear one
            axle, side = side, axle
        if side in SIDES and (axle in AXLES or not axle):
            sides.add(SIDES[side])
            rest += [AXLES[axle]] if axle else []
        else:
            rest.append(word)
    return JointName(sides.pop() if len(sides) == 1 else None, tuple(rest))


def wheel_pairs(names: Iterable[str]) -> List[JointPair]:
    """The pairs of joints that could be the wheels, in the order of the names.

    The two names of a pair differ in nothing but the side, unless there is only one wheel on each side. Joints that are
    called wheels are preferred.
    """
    parsed = {name: parse_joint_name(name) for name in names}
    wheels = {name: joint for name, joint in parsed.items() if joint.is_wheel}
    plain = {name: joint for name, joint in parsed.items() if joint.is_plain}
    return _pairs(wheels) or _only_pair(wheels) or _pairs(plain)


def partner(name: str, names: Iterable[str]) -> Optional[str]:
    """The joint whose name differs from this one in nothing but the side; None without one."""
    side, words = parse_joint_name(name)
    opposite = JointName("right" if side == "left" else "left", words)
    others = [other for other in names if parse_joint_name(other) == opposite]
    return others[0] if side is not None and len(others) == 1 else None


def are_of_one_base(pairs: Iterable[JointPair]) -> bool:
    """Whether wheels differ in nothing but their place, such as front and rear."""
    joints = [parse_joint_name(pair.left) for pair in pairs]
    return len({tuple(word for word in joint.words if word not in joint.place) for joint in joints}) == 1


def _pairs(joints: Dict[str, JointName]) -> List[JointPair]:
    rights: Dict[Tuple[str, ...], List[str]] = {}
    for name, joint in joints.items():
        if joint.side == "right":
            rights.setdefault(joint.words, []).append(name)
    lefts = ((name, joint.words) for name, joint in joints.items() if joint.side == "left")
    return [JointPair(left, right) for left, words in lefts for right in rights.get(words, [])]


def _only_pair(joints: Dict[str, JointName]) -> List[JointPair]:
    lefts, rights = ([name for name, joint in joints.items() if joint.side == side] for side in ("left", "right"))
    return [JointPair(lefts[0], rights[0])] if len(lefts) == len(rights) == 1 else []
