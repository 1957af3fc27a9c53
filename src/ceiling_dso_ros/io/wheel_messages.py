# SPDX-License-Identifier: BSD-3-Clause
"""Wheel encoder counters from ROS messages."""

from typing import Iterable, List, Optional, Sequence, Tuple

import numpy as np

from ceiling_dso_ros.io.recording import WheelSamples, WheelUnit
from ceiling_dso_ros.io.ros_messages import RosMessage, header_stamp_ns
from ceiling_dso_ros.io.tick_pairs import TickPairs
from ceiling_dso_ros.io.wheel_joints import WheelJoints


def samples_of_counters(counters: Iterable[Tuple[str, int, int]]) -> Optional[WheelSamples]:
    """Samples of both wheels' counters, (left or right, stamp_ns, ticks) in the order of time; None without a pair."""
    pairs = TickPairs()
    rows = [pair for pair in (pairs.add(*counter) for counter in counters) if pair is not None]
    return _samples(WheelUnit.TICKS, np.array(rows, np.int64)) if rows else None


def samples_of_joint_states(states: Sequence[RosMessage], joints: WheelJoints) -> Optional[WheelSamples]:
    """Samples of the wheels' angles in sensor_msgs/JointState messages; None where no message has both wheels."""
    stamps_ns: List[int] = []
    angles: List[Tuple[float, float]] = []
    for state in states:
        found = joints.angles_rad(state.name, state.position)
        if found is not None and np.isfinite(found).all():
            stamps_ns.append(header_stamp_ns(state.header))
            angles.append(found)
    if not angles:
        return None
    kept = _increasing(np.array(stamps_ns, np.int64))
    left, right = np.array(angles)[kept].T
    return WheelSamples(WheelUnit.RADIANS, np.array(stamps_ns, np.int64)[kept], left, right)


def _samples(unit: WheelUnit, table: np.ndarray) -> WheelSamples:
    stamps_ns, left, right = table[_increasing(table[:, 0])].T
    return WheelSamples(unit, stamps_ns, left, right)


def _increasing(stamps_ns: np.ndarray) -> np.ndarray:
    """Mask of those stamps that are larger than all before them."""
    newest = np.maximum.accumulate(stamps_ns)
    return np.r_[True, stamps_ns[1:] > newest[:-1]]
