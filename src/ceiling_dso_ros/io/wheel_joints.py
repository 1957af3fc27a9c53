# SPDX-License-Identifier: BSD-3-Clause
"""Finds the wheels among the joints of a robot and reads their angles, in the same way for nodes and offline runs."""

import math
from typing import Dict, List, NamedTuple, Optional, Sequence, Tuple

from ceiling_dso_ros.io.joint_names import JointPair, are_of_one_base, partner, wheel_pairs
from ceiling_dso_ros.io.limits import LARGEST_RAD, MOST_JOINTS
from ceiling_dso_ros.io.tick_pairs import TickPairs

PARAMETERS = ("left_joint", "right_joint")  # of the node, with which the wheels are named
# Wheels of one side are compared over this way: one and a half turns, much more than the play of gears and belts.
COMPARED_RAD = 10.0
# Wheels of one side that are coupled, or driven alike, roll as far as each other but for their radii, some percent.
DIFFERENT_SHARE = 0.1


class WheelAngles(NamedTuple):
    """Both wheels at a time, radians."""

    stamp_ns: int
    left: float
    right: float


class WheelJoints:
    """Reads the angles of the left and the right wheel from joint_states messages.

    Several publishers may share the topic: messages with other joints only are ignored. The wheels are known from the
    first message on that leaves no doubt. A base with several wheels on each side counts as one with their mean.

    Attributes:
        complaint: what is wrong with the last message, in words; empty if nothing is, or if it is ignored.
        remedy: how to name the wheels, in words.
    """

    def __init__(self, left_joint: str = "", right_joint: str = "", options: Tuple[str, str] = PARAMETERS) -> None:
        """Begin.

        Args:
            left_joint: name of the left wheel; an empty one is found.
            right_joint: of the right wheel.
            options: what both are named with, for messages.
        """
        self.complaint = ""
        self.remedy = f"name the wheels with {' and '.join(options)}"
        self._options = options
        self._left_joint, self._right_joint = left_joint, right_joint
        self._seen: Dict[str, None] = {}  # a dict keeps their order
        self._pairs: List[JointPair] = []
        self._sides: List[_Side] = []
        self._separate = TickPairs[float]()

    @property
    def missing(self) -> str:
        """Why the wheels are not known yet, in words; empty when they are."""
        if self._pairs:
            return ""
        given = {option: name for option, name in zip(self._options, (self._left_joint, self._right_joint)) if name}
        absent = [f"{name} ({option})" for option, name in given.items() if name not in self._seen]
        if absent:
            return f"{' and '.join(absent)} {'is' if len(absent) == 1 else 'are'} not among {self._names()}"
        if given:
            (name,) = given.values()
            (other,) = {*self._options} - {*given}
            return f"{name} has no counterpart among {self._names()}; name it with {other}"
        found = self._candidates()
        if found:
            return f"several pairs of joints could be the wheels: {', or '.join(map(str, found))}; {self.remedy}"
        return f"no left and right wheel among {self._names()}; {self.remedy}"

    @property
    def pairs(self) -> Sequence[JointPair]:
        """The wheels, one pair for each axle; empty while they are not known."""
        return self._pairs

    def read(
        self, stamp_ns: int, names: Sequence[str], positions: Sequence[float], velocities: Sequence[float] = ()
    ) -> Optional[WheelAngles]:
        """Read a message; None if it does not have the wheels, or `complaint`.

        Wheels whose messages come separately are paired as counters are, see `TickPairs`.
        """
        self.complaint = ""
        new = [name for name in dict.fromkeys(names) if name not in self._seen]
        if new and len(self._seen) < MOST_JOINTS:
            self._seen.update(dict.fromkeys(new[: MOST_JOINTS - len(self._seen)]))
            self._choose()
        here = {name for pair in self._pairs for name in pair} & {*names}
        angles = {name: angle for name, angle in zip(names, positions) if name in here}
        if not here:
            return None
        if len(angles) < len(here):
            only = "only velocities" if len(velocities) == len(names) else "and no positions"
            self.complaint = self.complaint or f"{', '.join(sorted(here - angles.keys()))} without a position, {only}"
            return None
        for name, angle in angles.items():
            if not abs(angle) < LARGEST_RAD:
                what = f"{angle:g}, which is no angle of a wheel" if math.isfinite(angle) else "not finite"
                self.complaint = f"the position of {name} is {what}"
                return None
        return self._combine(stamp_ns, angles)

    def _combine(self, stamp_ns: int, angles: Dict[str, float]) -> Optional[WheelAngles]:
        if all(name in angles for side in self._sides for name in side.joints):
            left, right = (side.mean(angles) for side in self._sides)
            self.complaint = self.complaint or next(filter(None, (side.disagreement for side in self._sides)), "")
            return WheelAngles(stamp_ns, left, right)
        pair, counters = self._pairs[0], None
        for side, name in zip(("left", "right"), pair):
            if name in angles:
                counters = self._separate.add(side, stamp_ns, angles[name]) or counters
        return None if counters is None else WheelAngles(*counters)

    def _choose(self) -> None:
        """Choose the wheels, or say that others could be meant, too, than those that have been chosen."""
        found = self._candidates()
        if not self._pairs and (len(found) == 1 or (found and are_of_one_base(found))):
            self._pairs = found
            self._sides = [_Side(joints, self.remedy) for joints in zip(*found)]
        elif self._pairs and not {*self._pairs} <= {*found}:
            others = ", or ".join(str(pair) for pair in found if pair not in self._pairs)
            self.complaint = f"{self._pairs[0]} are used as the wheels, it could be {others}; {self.remedy}"

    def _candidates(self) -> List[JointPair]:
        seen = list(self._seen)
        if self._left_joint and self._right_joint:
            named = JointPair(self._left_joint, self._right_joint)
            return [named] if {*named} <= {*seen} else []
        if self._left_joint:
            right = partner(self._left_joint, seen) if self._left_joint in seen else None
            return [] if right is None else [JointPair(self._left_joint, right)]
        if self._right_joint:
            left = partner(self._right_joint, seen) if self._right_joint in seen else None
            return [] if left is None else [JointPair(left, self._right_joint)]
        return wheel_pairs(seen)

    def _names(self) -> str:
        return ", ".join(self._seen) or "its joints, it has none"


class _Side:
    """The wheels of one side, which count as one.

    Attributes:
        joints: their names.
        disagreement: that they do not roll alike, in words; said once, when it is found.
    """

    def __init__(self, joints: Sequence[str], remedy: str) -> None:
        self.joints = joints
        self._remedy = remedy
        self.disagreement = ""
        self._angles: Optional[List[float]] = None
        self._ahead = [0.0] * len(joints)  # what each has rolled more than the first, endless
        self._compared = list(self._ahead)  # the same when the comparison began
        self._rolled_rad = 0.0
        self._said = False

    def mean(self, angles: Dict[str, float]) -> float:
        """Their mean angle, which wraps where that of the first wheel does."""
        new = [angles[name] for name in self.joints]
        if len(new) > 1 and self._angles is not None:
            steps = [_wrapped(after - before) for before, after in zip(self._angles, new)]
            self._ahead = [ahead + _wrapped(step - steps[0]) for ahead, step in zip(self._ahead, steps)]
            self._rolled_rad += abs(steps[0])
            self._compare()
        self._angles = new
        return new[0] + sum(self._ahead) / len(new)

    def _compare(self) -> None:
        self.disagreement = ""
        if self._rolled_rad < COMPARED_RAD:
            return
        apart = [abs(ahead - before) / self._rolled_rad for before, ahead in zip(self._compared, self._ahead)]
        worst = max(range(len(apart)), key=apart.__getitem__)
        if apart[worst] > DIFFERENT_SHARE and not self._said:
            self._said = True
            self.disagreement = (
                f"{self.joints[0]} and {self.joints[worst]} roll differently, by {apart[worst]:.0%}, and their mean is "
                f"used; {self._remedy}"
            )
        self._rolled_rad, self._compared = 0.0, list(self._ahead)


def _wrapped(angle_rad: float) -> float:
    return (angle_rad + math.pi) % (2.0 * math.pi) - math.pi
