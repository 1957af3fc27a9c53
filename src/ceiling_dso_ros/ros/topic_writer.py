# SPDX-License-Identifier: BSD-3-Clause
"""Publishes what would be written into a bag, and the time."""

import time
from typing import Dict

import rospy
from rosgraph_msgs.msg import Clock
from roslib.message import get_message_class

from ceiling_dso_ros.io.message_writer import MessageWriter
from ceiling_dso_ros.io.ros_messages import TYPES, RosMessage

QUEUE_SIZE = 50


class SimulatedClock:
    """Publishes /clock, in step with the real time.

    Args:
        rate: simulated seconds per real second at most; 0 for as many as possible.
    """

    def __init__(self, rate: float) -> None:
        self._rate = rate
        self._publisher = rospy.Publisher("/clock", Clock, queue_size=10)
        self._start_s = time.monotonic()
        self._start_ns, self._now_ns = 0, 0

    def advance(self, stamp_ns: int) -> None:
        """Wait until it is that time; if it is over already, later times are delayed as well. Time never goes back.

        Raises:
            rospy.ROSInterruptException: the node is shut down.
        """
        if rospy.is_shutdown():
            raise rospy.ROSInterruptException
        if self._rate > 0.0:
            self._start_ns = self._start_ns or stamp_ns
            due_s = self._start_s + 1e-9 * (stamp_ns - self._start_ns) / self._rate
            ahead_s = due_s - time.monotonic()
            if ahead_s > 0.0:
                time.sleep(ahead_s)
            else:
                self._start_s -= ahead_s
        self._now_ns = max(stamp_ns, self._now_ns)
        self._publisher.publish(Clock(rospy.Time(0, self._now_ns)))


class TopicWriter(MessageWriter):
    """Publishes messages instead of writing them into a bag."""

    def __init__(self) -> None:
        super().__init__()
        self._publishers: Dict[str, rospy.Publisher] = {}

    def write(self, topic: str, stamp_ns: int, content: RosMessage, latched: bool = False) -> None:
        """See MessageWriter."""
        package, _, name = content.__msgtype__.split("/")
        kind = get_message_class(f"{package}/{name}")
        topic = topic if topic.startswith("/tf") else topic.lstrip("/")  # within the namespace of the node
        if topic not in self._publishers:
            self._publishers[topic] = rospy.Publisher(topic, kind, queue_size=QUEUE_SIZE, latch=latched)
        publisher = self._publishers[topic]
        if latched or publisher.get_num_connections() > 0:
            publisher.publish(kind().deserialize(bytes(TYPES.serialize_ros1(content, content.__msgtype__))))
