# SPDX-License-Identifier: BSD-3-Clause
"""Publishes tf of the base, and makes sure that no frame gets two parents."""

from typing import Optional

import numpy as np
import rospy
import tf2_ros
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.io.errors import one_line
from ceiling_dso_ros.ros.planar_messages import planar_transform


class BaseTransform:
    """Broadcasts `odom -> base_link`, or a correction above odom if the wheel driver broadcasts `odom -> base_link`.

    Args:
        mode: `odom` for odom_frame -> base_frame; `correction` for odom_frame -> the wheel odometry's frame; `none`.
        odom_frame: frame of the fused pose.
        base_frame: the robot.

    Attributes:
        complaint: why nothing is broadcast, in words; empty when it is.
    """

    def __init__(self, mode: str, odom_frame: str, base_frame: str) -> None:
        self.complaint = ""
        self._mode, self._odom_frame, self._base_frame = mode, odom_frame, base_frame
        self._broadcaster: Optional[tf2_ros.TransformBroadcaster] = None
        if mode != "none":
            self._broadcaster = tf2_ros.TransformBroadcaster()
        if mode == "odom":
            rospy.Subscriber("/tf", TFMessage, self._on_tf, queue_size=100, tcp_nodelay=True)

    def send(self, stamp: rospy.Time, pose: np.ndarray, wheel_frame: str, wheel_pose: np.ndarray) -> None:
        """Broadcast.

        Args:
            stamp: of the fused pose.
            pose: (3,) fused, of the base in odom_frame.
            wheel_frame: frame of the wheel odometry.
            wheel_pose: (3,) of the base in it.
        """
        header = Header(stamp=stamp, frame_id=self._odom_frame)
        if self._mode == "correction" and wheel_frame == self._odom_frame:
            self.complaint = (
                f"the wheel odometry's frame is {wheel_frame}, too: give the fused pose another ~odom_frame, "
                "such as odom_fused"
            )
        if self._broadcaster is None or self.complaint:
            return
        if self._mode == "correction":
            correction = planar.compose(pose, planar.inverse(wheel_pose))
            self._broadcaster.sendTransform(planar_transform(header, wheel_frame, correction))
        else:
            self._broadcaster.sendTransform(planar_transform(header, self._base_frame, pose))

    def _on_tf(self, message: TFMessage) -> None:
        """Stop broadcasting for good if the base has another parent: with two parents the robot would jump."""
        sender = message._connection_header.get("callerid", "another node")
        if self.complaint or sender == rospy.get_name():
            return
        for transform in message.transforms:
            if transform.child_frame_id.lstrip("/") == self._base_frame:
                self.complaint = one_line(
                    f"{sender} publishes {transform.header.frame_id[:100]} -> {self._base_frame} already: no tf from "
                    "here; switch that off, or set ~tf_mode to correction, and start this node again"
                )
                rospy.logerr(self.complaint)
                return
