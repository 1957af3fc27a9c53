# SPDX-License-Identifier: BSD-3-Clause
"""nav_msgs/Path of the last poses, for display. Each message has the whole path, so it is sent rarely.

The poses are thinned and kept as the bytes of their messages: twenty thousand of them take two megabytes, and to send
them takes a millisecond.
"""

import math
import struct
import threading
from io import BytesIO
from typing import List, Optional, Tuple

import rospy
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path

from ceiling_dso_ros.ros.periodic import Periodic


class ReadyPath(Path):  # type: ignore[misc]  # ROS has no types
    """A path whose poses have been serialised."""

    serialised: List[bytes]

    def serialize(self, buff: BytesIO) -> None:
        """Write the message, as rospy asks for it."""
        self.header.serialize(buff)
        buff.write(struct.pack("<I", len(self.serialised)))
        buff.write(b"".join(self.serialised))


class PathPublisher:
    """One topic, sent by a thread of its own and only to subscribers.

    Attributes:
        length: poses that are kept.
        spacing: smallest distance between two of them; the newest pose is always the last one.
        period_s: shortest time between two messages, of the wall clock.
    """

    def __init__(self, topic: str, spacing: float, length: int = 5000, period_s: float = 0.5) -> None:
        self.length, self.spacing = length, spacing
        self._publisher = rospy.Publisher(topic, Path, queue_size=1)
        self._lock = threading.Lock()
        self._has_news = threading.Event()
        self.clear()
        self._sending = Periodic(self._send, period_s, topic)

    @property
    def period_s(self) -> float:
        """Shortest time between two messages, of the wall clock."""
        return self._sending.period_s

    @period_s.setter
    def period_s(self, period_s: float) -> None:
        self._sending.period_s = period_s

    def clear(self) -> None:
        """Forget the poses so far."""
        with self._lock:
            self._poses: List[bytes] = []
            self._place: Optional[Tuple[float, float, float]] = None  # of the last one that is kept
            self._newest: Optional[PoseStamped] = None

    def add(self, pose: PoseStamped) -> None:
        """Append a pose; it is kept if it is far enough from the last one that is."""
        place = pose.pose.position.x, pose.pose.position.y, pose.pose.position.z
        with self._lock:
            self._newest = pose
            if self._place is None or math.dist(place, self._place) >= self.spacing:
                self._place = place
                self._poses.append(serialised(pose))
                del self._poses[: -self.length]
        self._has_news.set()

    def _send(self) -> None:
        if not self._has_news.is_set():
            return
        self._has_news.clear()
        if self._publisher.get_num_connections() == 0:
            return
        with self._lock:
            newest, poses = self._newest, list(self._poses)
        if newest is not None:
            last = serialised(newest)
            path = ReadyPath(header=newest.header)
            path.serialised = poses if poses[-1] == last else [*poses, last][-self.length :]
            self._publisher.publish(path)


def serialised(pose: PoseStamped) -> bytes:
    """The bytes of a message."""
    buffer = BytesIO()
    pose.serialize(buffer)
    return buffer.getvalue()
