# SPDX-License-Identifier: BSD-3-Clause
"""Waits for the nodes that work on what is published, so that simulated time does not run away from them."""

import struct
import threading
import time

import rospy

ANSWER_LIMIT_S = 10.0  # real seconds; an image takes a tenth of a second on the slowest machine
TRUSTED_AFTER = 10  # answers in time, after one that was missing
STAMP = struct.Struct("<III")  # std_msgs/Header begins with seq and the stamp's seconds and nanoseconds


class Answers:
    """A topic on which a node answers every image with a message of the same stamp or a later one.

    It is waited for only while its node runs, from its first answer on. If an answer is missing for ANSWER_LIMIT_S,
    because the node leaves images out, time goes on until it has answered TRUSTED_AFTER images in a row in time.

    Args:
        topic: of messages that begin with a header.
    """

    def __init__(self, topic: str) -> None:
        self._condition = threading.Condition()
        self._asked_ns, self._newest_ns = 0, 0
        self._has_missed, self._in_a_row = False, 0
        self._subscriber = rospy.Subscriber(topic, rospy.AnyMsg, self._on_answer, queue_size=100, tcp_nodelay=True)

    def ask(self, stamp_ns: int) -> None:
        """An image with this stamp is about to be published."""
        with self._condition:
            self._asked_ns = stamp_ns

    def wait(self) -> None:
        """Wait for the answer to the image that was asked about.

        Raises:
            rospy.ROSInterruptException: the node is shut down.
        """
        deadline_s = time.monotonic() + ANSWER_LIMIT_S
        with self._condition:
            self._count()
            while self._is_missing():
                if rospy.is_shutdown():
                    raise rospy.ROSInterruptException
                if time.monotonic() > deadline_s:
                    self._has_missed, self._in_a_row = True, 0
                    rospy.logwarn(
                        f"{self._subscriber.resolved_name} has not answered an image for {ANSWER_LIMIT_S:g} s: time no "
                        f"longer waits for it, until it has answered {TRUSTED_AFTER} in a row"
                    )
                self._condition.wait(0.05)

    def _count(self) -> None:
        if self._subscriber.get_num_connections() == 0:
            self._newest_ns = 0  # another node begins anew
        self._in_a_row = self._in_a_row + 1 if self._asked_ns <= self._newest_ns else 0
        self._has_missed = self._has_missed and self._in_a_row < TRUSTED_AFTER

    def _is_missing(self) -> bool:
        """Whether there is an answer to be waited for."""
        is_expected = self._newest_ns > 0 and not self._has_missed and self._subscriber.get_num_connections() > 0
        return is_expected and self._newest_ns < self._asked_ns

    def _on_answer(self, message: rospy.AnyMsg) -> None:
        if not _begins_with_header(message._connection_header["message_definition"]):
            rospy.logwarn_once(f"{self._subscriber.resolved_name} is not waited for: its messages have no header")
            return
        _, secs, nsecs = STAMP.unpack_from(message._buff)
        with self._condition:
            self._newest_ns = secs * 1_000_000_000 + nsecs
            self._condition.notify_all()


def _begins_with_header(definition: str) -> bool:
    """Whether the first field of a message is a header; constants are no fields."""
    lines = (line.split("#")[0].strip() for line in definition.splitlines())
    first = next((line for line in lines if line and "=" not in line), "")
    return first.split(" ")[0] in ("Header", "std_msgs/Header")
