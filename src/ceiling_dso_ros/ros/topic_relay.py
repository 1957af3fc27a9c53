# SPDX-License-Identifier: BSD-3-Clause
"""Passes the messages of ROS topics on to the process that started this one, which needs no ROS then."""

import sys
import time
from multiprocessing.connection import Connection
from threading import Lock
from typing import List

import rosgraph
import rospy

from ceiling_dso_ros.io.bag_writer import SerializedMessage

QUEUE_SIZE = 100


class TopicRelay:
    """Sends every message of some topics, of any type, as a SerializedMessage."""

    def __init__(self, connection: Connection, topics: List[str]) -> None:
        self._connection, self._lock = connection, Lock()
        for topic in topics:
            rospy.Subscriber(topic, rospy.AnyMsg, self._pass_on, callback_args=topic, queue_size=QUEUE_SIZE)

    def wait(self) -> None:
        """Work until the other process hangs up."""
        try:
            self._connection.recv()
        except (EOFError, OSError):
            rospy.signal_shutdown("nobody listens any more")

    def _pass_on(self, message: rospy.AnyMsg, topic: str) -> None:
        header = message._connection_header
        relayed = SerializedMessage(
            topic,
            time.time_ns(),
            header["type"],
            header["message_definition"],
            header["md5sum"],
            message._buff,
            header.get("latching") == "1",
        )
        with self._lock:
            self._connection.send(relayed)


def main() -> int:
    """Relay the topics that are named after the connection's descriptor; returns the exit code."""
    descriptor, *topics = sys.argv[1:]
    if not rosgraph.is_master_online():
        return 2
    rospy.init_node("ceiling_dso_record", anonymous=True, disable_signals=True)
    connection = Connection(int(descriptor))
    connection.send(None)  # ROS is there
    TopicRelay(connection, topics).wait()
    return 0


if __name__ == "__main__":
    sys.exit(main())
