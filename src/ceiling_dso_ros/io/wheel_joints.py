# SPDX-License-Identifier: BSD-3-Clause
"""Finds the two wheels among the joints of a robot, in the same way for nodes and offline runs."""

from typing import List, Optional, Sequence, Tuple


class WheelJoints:
    """Finds the angles of the left and the right wheel in a joint_states message."""

    def __init__(self, left_joint: str = "", right_joint: str = "") -> None:
        """Take the names of the joints; an empty one means the only joint whose name contains the side."""
        self._joints = (("left", left_joint), ("right", right_joint))

    def angles_rad(self, names: Sequence[str], positions: Sequence[float]) -> Optional[Tuple[float, float]]:
        """Left and right angle, radians; None where one of the wheels is missing, or several joints could be one."""
        left, right = ([*_of_side(names, positions, side, joint)] for side, joint in self._joints)
        return (left[0], right[0]) if len(left) == len(right) == 1 else None


def _of_side(names: Sequence[str], positions: Sequence[float], side: str, joint: str) -> List[float]:
    return [angle for name, angle in zip(names, positions) if (name == joint if joint else side in name)]
