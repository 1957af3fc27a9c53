# SPDX-License-Identifier: BSD-3-Clause
"""Finds the wheel data of a bag: what is asked for, else encoder ticks, else joint states."""

from pathlib import Path
from typing import Callable, Iterator, List, Mapping, Optional, Tuple

from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.recording import TopicNames, WheelSamples
from ceiling_dso_ros.io.ros_messages import RosMessage
from ceiling_dso_ros.io.wheel_joints import WheelJoints
from ceiling_dso_ros.io.wheel_messages import Warn, samples_of_counters, samples_of_joint_states, samples_of_odometry

TICKS, JOINT_STATES, ODOMETRY = "std_msgs/msg/Int32", "sensor_msgs/msg/JointState", "nav_msgs/msg/Odometry"
# As the argument wheel_input of the launch files, and what it needs of the topics.
INPUTS = ("joint_states", "ticks", "odometry")

# Message type and topics -> (topic, stamp_ns of the record, message) of all their messages.
Contents = Callable[..., Iterator[Tuple[str, int, RosMessage]]]


class BagWheels:
    """The wheel data of one bag."""

    def __init__(
        self, path: Path, types: Mapping[str, str], topics: TopicNames, contents: Contents, warn: Warn
    ) -> None:
        """Know the bag.

        Args:
            path: of the bag.
            types: topic -> type of its messages.
            topics: names of what is to be read.
            contents: reads the messages.
            warn: is told what is not used, and what could be.
        """
        self._path, self._types, self._topics, self._contents, self._warn = path, types, topics, contents, warn

    def read(self) -> Optional[WheelSamples]:
        """The samples; None where the bag has none.

        Raises:
            InputError: what is asked for is not there, or a message is damaged.
        """
        asked, topics = self._topics.wheel_input, self._topics
        if asked == "odometry":
            return self._asked_for(self._odometry(), ODOMETRY, topics.wheel_odometry)
        if asked == "ticks":
            return self._asked_for(self._ticks(), TICKS, topics.left_ticks, topics.right_ticks)
        if asked == "joint_states":
            return self._asked_for(self._joint_states(), JOINT_STATES, topics.joint_states)
        samples = self._ticks() or self._joint_states()
        if samples is None:
            self._warn_of_others()
        return samples

    def _ticks(self) -> Optional[WheelSamples]:
        sides = {self._topics.left_ticks: "left", self._topics.right_ticks: "right"}
        if not self._types.keys() >= sides.keys() or len(sides) < 2:
            return None
        counters = self._contents(TICKS, *sides)
        source = f"{self._path}, {' and '.join(sides)}"
        return samples_of_counters(
            ((sides[topic], recorded_ns, message.data) for topic, recorded_ns, message in counters), source, self._warn
        )

    def _joint_states(self) -> Optional[WheelSamples]:
        topics = self._topics
        if topics.joint_states not in self._types:
            return None
        states = ((recorded_ns, state) for _, recorded_ns, state in self._contents(JOINT_STATES, topics.joint_states))
        joints = WheelJoints(topics.left_joint, topics.right_joint, ("--left-joint", "--right-joint"))
        return samples_of_joint_states(states, joints, f"{self._path}, {topics.joint_states}", self._warn)

    def _odometry(self) -> Optional[WheelSamples]:
        topics = self._topics
        if topics.wheel_odometry not in self._types:
            return None
        messages = ((recorded_ns, each) for _, recorded_ns, each in self._contents(ODOMETRY, topics.wheel_odometry))
        return samples_of_odometry(messages, topics.base_frame, f"{self._path}, {topics.wheel_odometry}", self._warn)

    def _asked_for(self, samples: Optional[WheelSamples], kind: str, *topics: str) -> WheelSamples:
        if samples is None:
            absent = [topic for topic in topics if topic not in self._types]
            if not absent:
                raise InputError(f"{self._path}: no samples on {' and '.join(topics)} that can be used, as said above")
            others = ", ".join(self._of_type(kind)) or "none"
            what = f"{' and '.join(absent)} not in the bag"
            raise InputError(f"{self._path}: {what}; its topics of {kind.replace('/msg', '')}: {others}")
        return samples

    def _warn_of_others(self) -> None:
        """Say what the bag has besides the topics that were looked at, and how it is used."""
        remedies = ((ODOMETRY, "--wheel-odometry"), (JOINT_STATES, "--joint-states"), (TICKS, "--left-ticks"))
        others = [
            f"{kind.replace('/msg', '')} on {topic} (use it with {option} {topic})"
            for kind, option in remedies
            for topic in self._of_type(kind)
            if topic != self._topics.joint_states
        ]
        if others:
            self._warn(f"{self._path}: no wheels are used; the bag has {', '.join(others)}")

    def _of_type(self, kind: str) -> List[str]:
        return sorted(topic for topic, message_type in self._types.items() if message_type == kind)
