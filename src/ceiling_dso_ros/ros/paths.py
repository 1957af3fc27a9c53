# SPDX-License-Identifier: BSD-3-Clause
"""nav_msgs/Path of the last poses. Each message has the whole path, so it is sent rarely and only to subscribers."""

import time
from typing import List

import numpy as np
import rospy
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path


class PathPublisher:
    """One topic.

    Attributes:
        length: poses that are kept.
        period_s: shortest time between two messages, of the wall clock.
    """

    def __init__(self, topic: str, length: int = 5000, period_s: float = 0.5) -> None:
        self.length, self.period_s = length, period_s
        self._publisher = rospy.Publisher(topic, Path, queue_size=1)
        self._poses: List[PoseStamped] = []
        self._sent_s = -np.inf

    def clear(self) -> None:
        """Forget the poses so far."""
        self._poses = []

    def add(self, pose: PoseStamped) -> None:
        """Append a pose; the path is sent if it is time."""
        self._poses.append(pose)
        del self._poses[: -self.length]
        now_s = time.monotonic()
        if self._publisher.get_num_connections() > 0 and now_s >= self._sent_s + self.period_s:
            self._publisher.publish(Path(pose.header, self._poses))
            self._sent_s = now_s
