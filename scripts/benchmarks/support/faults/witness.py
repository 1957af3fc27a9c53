# SPDX-License-Identifier: BSD-3-Clause
"""Hears everything that the nodes say, with the time at which it came."""

import re
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import Dict, List, Optional, Tuple

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Log

from ceiling_dso_ros.io.ros_messages import planar_pose
from ceiling_dso_ros.msg import FusionStatus, VisualOdometryStatus

QUIET_S = 0.5  # without a reason for so long, the fusion has recovered


@dataclass(frozen=True)
class Output:
    """One pose of the robot.

    Attributes:
        arrival_s: monotonic time.
        stamp_ns: of the message.
        pose: x, y, yaw, (3,).
        covariance: of x and y, (2, 2).
        is_finite: all numbers of the message are finite, and the variances positive.
    """

    arrival_s: float
    stamp_ns: int
    pose: np.ndarray
    covariance: np.ndarray
    is_finite: bool


class Witness:
    """Subscribes to what the nodes publish.

    Attributes:
        outputs: of odometry/filtered.
        wheel_poses: stamp -> pose of wheel/odometry, nanoseconds -> (3,).
        said: (monotonic time, text) of warnings, reasons and messages.
        visual: (monotonic time, status) of the images.
        fused: (monotonic time, status) of the fusion.
    """

    def __init__(self) -> None:
        self.outputs: List[Output] = []
        self.wheel_poses: Dict[int, np.ndarray] = {}
        self.said: List[Tuple[float, str]] = []
        self.visual: List[Tuple[float, VisualOdometryStatus]] = []
        self.fused: List[Tuple[float, FusionStatus]] = []
        self._subscribers = [
            rospy.Subscriber("odometry/filtered", Odometry, self._on_output, queue_size=1000, tcp_nodelay=True),
            rospy.Subscriber("wheel/odometry", Odometry, self._on_wheels, queue_size=1000),
            rospy.Subscriber("fusion/status", FusionStatus, self._on_fused, queue_size=1000),
            rospy.Subscriber("visual_odometry/status", VisualOdometryStatus, self._on_visual, queue_size=1000),
            rospy.Subscriber("/diagnostics", DiagnosticArray, self._on_diagnostics, queue_size=100),
            rospy.Subscriber("/rosout", Log, self._on_log, queue_size=1000),
        ]

    def forget(self) -> None:
        """Forget what was heard so far."""
        for heard in (self.outputs, self.said, self.visual, self.fused):
            del heard[:]
        self.wheel_poses.clear()

    def has_converged(self) -> bool:
        """Whether the newest state of the fusion is good."""
        return bool(self.fused) and self.fused[-1][1].state == FusionStatus.CONVERGED

    def converged_since(self, start_s: float) -> Optional[float]:
        """Monotonic time since which the fusion is good until now, none of it before start_s; None if it is not."""
        good_s = None
        for arrival_s, status in reversed(self.fused):
            if status.state != FusionStatus.CONVERGED or arrival_s < start_s:
                break
            good_s = arrival_s
        is_over = good_s is not None and self.fused[-1][0] - good_s >= QUIET_S
        return good_s if is_over else None

    def said_after_s(self, pattern: str, start_s: float) -> Optional[float]:
        """Seconds from start_s until something that the pattern finds was said; None: never."""
        found = (at_s - start_s for at_s, text in self.said if at_s >= start_s and re.search(pattern, text))
        return next(found, None)

    def _on_output(self, message: Odometry) -> None:
        arrival_s = time.monotonic()
        covariances = np.reshape([*message.pose.covariance, *message.twist.covariance], (2, 6, 6))
        twist = message.twist.twist
        numbers = [*covariances.ravel(), twist.linear.x, twist.linear.y, twist.angular.z]
        is_finite = bool(np.isfinite(numbers).all() and (np.diagonal(covariances, axis1=1, axis2=2) > 0.0).all())
        try:
            pose = planar_pose(message.pose.pose)
        except ValueError:
            pose, is_finite = np.zeros(3), False
        self.outputs.append(Output(arrival_s, message.header.stamp.to_nsec(), pose, covariances[0, :2, :2], is_finite))

    def _on_wheels(self, message: Odometry) -> None:
        with suppress(ValueError):  # somebody else's nonsense
            self.wheel_poses[message.header.stamp.to_nsec()] = planar_pose(message.pose.pose)

    def _on_fused(self, status: FusionStatus) -> None:
        self.fused.append((time.monotonic(), status))
        self._hear(", ".join(status.reasons))

    def _on_visual(self, status: VisualOdometryStatus) -> None:
        self.visual.append((time.monotonic(), status))
        self._hear(status.message)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.level:
                self._hear(status.message)

    def _on_log(self, message: Log) -> None:
        if message.level >= Log.WARN:
            self._hear(message.msg)

    def _hear(self, text: str) -> None:
        if text:
            self.said.append((time.monotonic(), text))
