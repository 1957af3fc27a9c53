"""Wheel encoders out of ROS messages."""

from typing import Optional, Sequence, Tuple

import numpy as np

from ceiling_dso_ros.io.recording import WheelTicks
from ceiling_dso_ros.io.ros_messages import RosMessage, header_stamp_ns

MAX_SKEW_NS = 50_000_000  # between the messages of the two wheels


def ticks_of_counters(left: Sequence[Tuple[int, int]], right: Sequence[Tuple[int, int]]) -> Optional[WheelTicks]:
    """Pair the counters of two wheels, each a sequence of (stamp_ns, ticks) in the order of time.

    Every left value gets the right one nearest in time; it is dropped where there is none within MAX_SKEW_NS. None when
    nothing is left.
    """
    if not left or not right:
        return None
    left_table, right_table = _increasing(np.array(left, np.int64)), _increasing(np.array(right, np.int64))
    stamps_ns, right_ns = left_table[:, 0], right_table[:, 0]
    after = np.searchsorted(right_ns, stamps_ns).clip(0, len(right_ns) - 1)
    before = (after - 1).clip(0)
    nearest = np.where(stamps_ns - right_ns[before] < right_ns[after] - stamps_ns, before, after)
    paired = np.abs(right_ns[nearest] - stamps_ns) <= MAX_SKEW_NS
    if not paired.any():
        return None
    return WheelTicks(stamps_ns[paired], left_table[paired, 1], right_table[nearest[paired], 1])


def ticks_of_joint_states(states: Sequence[RosMessage], ticks_per_turn: float) -> Optional[WheelTicks]:
    """Counters of the wheels' angles in sensor_msgs/JointState messages.

    The wheels are the joints whose names contain "left" and "right"; messages without both are left out. None when
    nothing is left.
    """
    rows = []
    for state in states:
        left = [angle for name, angle in zip(state.name, state.position) if "left" in name]
        right = [angle for name, angle in zip(state.name, state.position) if "right" in name]
        if len(left) == len(right) == 1 and np.isfinite([left[0], right[0]]).all():
            ticks = np.rint(np.array([left[0], right[0]]) / (2 * np.pi) * ticks_per_turn).astype(np.int64)
            rows.append((header_stamp_ns(state.header), *ticks))
    return WheelTicks(*_increasing(np.array(rows, np.int64)).T) if rows else None


def _increasing(table: np.ndarray) -> np.ndarray:
    """Rows of (stamp, ...) whose stamp is larger than that of all rows before."""
    stamps_ns = table[:, 0]
    newest = np.maximum.accumulate(stamps_ns)
    return table[np.r_[True, stamps_ns[1:] > newest[:-1]]]
