# SPDX-License-Identifier: BSD-3-Clause
"""Wheel data from recorded ROS messages, in the way in which the nodes take it in."""

from typing import Callable, Counter, Iterable, List, Optional, Sequence, Tuple

import numpy as np

from ceiling_dso_ros.io.recording import WheelSamples, WheelUnit
from ceiling_dso_ros.io.ros_messages import RosMessage, header_stamp_ns, planar_pose
from ceiling_dso_ros.io.stamps import longest_increasing, was_set_back
from ceiling_dso_ros.io.tick_pairs import MAX_SKEW_NS, TickPairs
from ceiling_dso_ros.io.wheel_joints import WheelJoints

Recorded = Iterable[Tuple[int, RosMessage]]  # when it was recorded, nanoseconds, and the message
Warn = Callable[[str], None]


def samples_of_counters(counters: Iterable[Tuple[str, int, int]], source: str, warn: Warn) -> Optional[WheelSamples]:
    """Samples of both wheels' counters; None without a pair.

    Args:
        counters: (left or right, stamp_ns, ticks) in the order of time; they count by the time of their recording.
        source: names them in messages.
        warn: is told what is not used.
    """
    table = _Table(WheelUnit.TICKS, source)
    pairs, count = TickPairs[int](), 0
    for counter in counters:
        count += 1
        pair = pairs.add(*counter)
        if pair is not None:
            stamp_ns, *ticks = pair
            table.add(stamp_ns, stamp_ns, ticks)
    table.unused[f"the other wheel has none within {MAX_SKEW_NS / 1e9:g} s"] = pairs.unpaired
    return table.samples(count, warn)


def samples_of_joint_states(states: Recorded, joints: WheelJoints, source: str, warn: Warn) -> Optional[WheelSamples]:
    """Samples of the wheels' angles in sensor_msgs/JointState messages; None where no message has both wheels."""
    table, count = _Table(WheelUnit.RADIANS, source), 0
    for recorded_ns, state in states:
        stamp_ns = header_stamp_ns(state.header)
        angles = joints.read(stamp_ns, state.name, state.position, state.velocity)
        if angles is not None and stamp_ns:
            table.add(recorded_ns, angles.stamp_ns, [angles.left, angles.right])
        count += angles is not None or bool(joints.complaint)  # those of other joints do not count
        if angles is not None and not stamp_ns:
            table.unused["without a stamp"] += 1
        elif angles is not None and joints.complaint:
            warn(f"{source}: {joints.complaint}")
        elif joints.complaint:
            table.unused[joints.complaint] += 1
    if joints.missing:
        warn(f"{source}: {joints.missing}")
    else:
        table.source = f"{source} ({', '.join(map(str, joints.pairs))})"
    return table.samples(count, warn)


def samples_of_odometry(messages: Recorded, base_frame: str, source: str, warn: Warn) -> Optional[WheelSamples]:
    """Samples of the planar poses in nav_msgs/Odometry messages; None where no message has a pose."""
    table, count = _Table(WheelUnit.POSES, source), 0
    children: List[str] = []
    for recorded_ns, message in messages:
        count += 1
        stamp_ns = header_stamp_ns(message.header)
        try:
            pose = planar_pose(message.pose.pose)
        except ValueError as error:
            table.unused[str(error)] += 1
            continue
        if not stamp_ns:
            table.unused["without a stamp"] += 1
            continue
        table.add(recorded_ns, stamp_ns, pose.tolist())
        if message.child_frame_id not in children:
            children.append(message.child_frame_id)
    for child in children:
        complaint = other_body(child, base_frame)
        if complaint:
            warn(f"{source}: {complaint}")
    return table.samples(count, warn)


def other_body(child_frame: str, base_frame: str) -> str:
    """What is wrong with the child frame of an odometry, in words; empty where it is the base, or a point below it."""
    child = child_frame.lstrip("/")
    if child in ("", base_frame.lstrip("/"), "base_footprint"):
        return ""
    return f"the poses are those of {child}, and are used as if they were those of {base_frame}"


class _Table:
    """Rows of samples, and what is not used."""

    def __init__(self, unit: WheelUnit, source: str) -> None:
        self.unused = Counter[str]()  # reason -> messages
        self._unit, self.source = unit, source
        self._stamps_ns: List[int] = []
        self._recorded_ns: List[int] = []
        self._readings: List[Sequence[float]] = []

    def add(self, recorded_ns: int, stamp_ns: int, reading: Sequence[float]) -> None:
        """Add a sample; `samples` leaves out those whose stamps are out of order."""
        self._stamps_ns.append(stamp_ns)
        self._recorded_ns.append(recorded_ns)
        self._readings.append(reading)

    def samples(self, count: int, warn: Warn) -> Optional[WheelSamples]:
        """The samples, None without any; warns of those that are not used."""
        kept = longest_increasing(self._stamps_ns)
        self.unused["not later than the one before, or far ahead of the next"] = len(self._stamps_ns) - len(kept)
        for reason, unused in self.unused.items():
            if unused:
                warn(f"{self.source}: {unused} of {count} messages are not used: {reason}")
        if not kept:
            return None
        readings = np.array(self._readings, np.int64 if self._unit is WheelUnit.TICKS else np.float64)[kept]
        stamps_ns, recorded_ns = np.array([self._stamps_ns, self._recorded_ns], np.int64)
        return WheelSamples(
            self._unit,
            stamps_ns[kept],
            readings,
            self.source,
            delay_ns=int(np.median(recorded_ns - stamps_ns)),
            set_back=was_set_back(stamps_ns),
            arrivals_ns=np.stack([stamps_ns, recorded_ns], axis=1),
        )
