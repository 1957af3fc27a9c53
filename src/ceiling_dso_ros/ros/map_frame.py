# SPDX-License-Identifier: BSD-3-Clause
"""The transform map -> odom."""

import threading
from collections import deque
from typing import Deque, Optional, Tuple

import numpy as np
import rospy
import tf2_ros
from std_msgs.msg import Header

from ceiling_dso_ros.dso.durations import nanoseconds
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.ros.conversions import ros_time
from ceiling_dso_ros.ros.periodic import Periodic
from ceiling_dso_ros.ros.planar_messages import planar_transform

REMEMBERED_POSES = 2000  # longer than a keyframe takes to its place
PERIOD_S = 0.05


class MapFrame:
    """Sends map -> odom again and again while it is known, stamped a little ahead of the odometry, as amcl does.

    Args:
        map_frame, odom_frame: the frames.
        tolerance_s: by which it is ahead.
        send: whether it is sent at all.
    """

    def __init__(self, map_frame: str, odom_frame: str, tolerance_s: float, send: bool) -> None:
        self._map_frame, self._odom_frame = map_frame, odom_frame
        self._tolerance_ns = nanoseconds(tolerance_s)
        self._lock = threading.Lock()
        self._poses: Deque[Tuple[int, np.ndarray]] = deque(maxlen=REMEMBERED_POSES)
        self._arrival_s = 0.0  # of the newest one, ROS time
        self._sent_ns = 0
        self._T_map_odom: Optional[np.ndarray] = None
        if send:
            self._broadcaster = tf2_ros.TransformBroadcaster()
            Periodic(self._send, PERIOD_S, "map -> odom")

    def add(self, stamp_ns: int, pose: np.ndarray) -> None:
        """Take in a pose of the odometry, (3,) base_link in odom."""
        with self._lock:
            if self._poses and stamp_ns <= self._poses[-1][0]:  # the clock was set back, or a bag begins again
                self._poses.clear()
                self._sent_ns = 0
            self._poses.append((stamp_ns, pose))
            self._arrival_s = rospy.get_time()

    def find(self, stamp_ns: int, pose: np.ndarray) -> None:
        """The robot was at a (3,) pose in map."""
        with self._lock:
            odom = self._odom_at(stamp_ns)
            if odom is not None:
                self._T_map_odom = planar.compose(pose, planar.inverse(odom))

    def lose(self) -> None:
        """The place is not known any more."""
        with self._lock:
            self._T_map_odom = None

    def _odom_at(self, stamp_ns: int) -> Optional[np.ndarray]:
        """(3,) of base_link in odom, between the two nearest poses; None before the first."""
        after: Optional[Tuple[int, np.ndarray]] = None
        for known_ns, pose in reversed(self._poses):
            if known_ns <= stamp_ns:
                if after is None:
                    return pose
                share = (stamp_ns - known_ns) / (after[0] - known_ns)
                return planar.compose(pose, planar.expmap(share * planar.logmap(planar.between(pose, after[1]))))
            after = known_ns, pose
        return None

    def _send(self) -> None:
        with self._lock:
            if self._T_map_odom is None or not self._poses:
                return
            since_ns = max(0, nanoseconds(rospy.get_time() - self._arrival_s))
            stamp_ns = self._poses[-1][0] + since_ns + self._tolerance_ns
            if stamp_ns <= self._sent_ns:  # time stands still
                return
            self._sent_ns = stamp_ns
            header = Header(stamp=ros_time(stamp_ns), frame_id=self._map_frame)
            transform = planar_transform(header, self._odom_frame, self._T_map_odom)
        self._broadcaster.sendTransform(transform)
