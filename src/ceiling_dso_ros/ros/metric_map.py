# SPDX-License-Identifier: BSD-3-Clause
"""Publishes the visual odometry's map in metres and in odom, for display."""

from collections import deque
from typing import Deque, Optional, Tuple

import numpy as np
import rospy
from geometry_msgs.msg import Pose, PoseArray
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from ceiling_dso_ros.dso import KeyframeEstimate
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.state import FusedState
from ceiling_dso_ros.ros.conversions import pose_from_matrix
from ceiling_dso_ros.ros.map_publisher import POINT_STEP

LONGEST_GAP_NS = 10**9  # between a window and points that are placed with it
REMEMBERED_POSES = 500  # longer than an image takes through the visual odometry


class MetricMap:
    """The topics `fusion/keyframes` and `fusion/points`.

    Each window is placed at the fused pose of its newest keyframe, with the scale at that time. It is for display only
    and is not corrected later.
    """

    def __init__(self, odom_frame: str) -> None:
        self._odom_frame = odom_frame
        self._keyframes = rospy.Publisher("fusion/keyframes", PoseArray, queue_size=1)
        self._points = rospy.Publisher("fusion/points", PointCloud2, queue_size=1, subscriber_listener=self)
        self._input: Optional[rospy.Subscriber] = None
        self.clear()

    def clear(self) -> None:
        """Clear the stored poses."""
        self._poses: Deque[Tuple[int, np.ndarray, float]] = deque(maxlen=REMEMBERED_POSES)
        self._placed: Optional[Tuple[int, np.ndarray]] = None

    def add_pose(self, state: FusedState) -> None:
        """Remember a fused pose."""
        self._poses.append((state.stamp_ns, state.pose, state.scale.value))

    def add_window(self, stamp: rospy.Time, keyframes: tuple, offset_ns: int, T_base_camera: np.ndarray) -> None:
        """Publish a window.

        Args:
            stamp: of the image that it was refined with.
            keyframes: KeyframeEstimate, not empty.
            offset_ns: what to add to an image's stamp to have it on the clock of the poses.
            T_base_camera: (4, 4).
        """
        newest: KeyframeEstimate = max(keyframes, key=lambda keyframe: keyframe.stamp_ns)
        at_ns = newest.stamp_ns + offset_ns
        if not self._poses or not np.isfinite(self._poses[-1][2]) or at_ns < self._poses[0][0]:
            return
        _, pose, scale = min(self._poses, key=lambda known: abs(known[0] - at_ns))
        S = np.diag([scale, scale, scale, 1.0])
        M = planar.lift(pose) @ T_base_camera @ S @ se3.inverse(newest.T_world_camera)  # VO world -> odom
        self._placed = (stamp.to_nsec(), M)
        if self._keyframes.get_num_connections() > 0:
            header = Header(stamp=stamp, frame_id=self._odom_frame)
            self._keyframes.publish(PoseArray(header, [_pose(M @ k.T_world_camera, scale) for k in keyframes]))

    def peer_subscribe(self, *_: object) -> None:
        """Called by rospy for a new subscriber: only then dso_node needs to send its points."""
        if self._input is None:
            self._input = rospy.Subscriber("visual_odometry/points", PointCloud2, self._on_points, queue_size=1)

    def peer_unsubscribe(self, _name: str, remaining: int) -> None:
        """Called by rospy when a subscriber leaves."""
        if remaining == 0 and self._input is not None:
            self._input.unregister()
            self._input = None

    def _on_points(self, message: PointCloud2) -> None:
        placed = self._placed
        if placed is None or abs(placed[0] - message.header.stamp.to_nsec()) > LONGEST_GAP_NS:
            return
        if message.point_step != POINT_STEP or len(message.data) % POINT_STEP:  # not of dso_node
            return
        table = np.frombuffer(message.data, np.float32).reshape(-1, 4).copy()
        table[:, :3] = table[:, :3] @ placed[1][:3, :3].T + placed[1][:3, 3]
        message.header.frame_id, message.data = self._odom_frame, table.tobytes()
        self._points.publish(message)


def _pose(T: np.ndarray, scale: float) -> Pose:
    """Pose of a transform whose rotation is scaled."""
    T = T.copy()
    T[:3, :3] /= scale
    return pose_from_matrix(T)
