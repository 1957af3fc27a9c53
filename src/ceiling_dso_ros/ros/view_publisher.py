# SPDX-License-Identifier: BSD-3-Clause
"""Publishes what the keyframes show that leave the window, for map_node; nothing is done without a subscriber."""

import threading
from collections import deque
from typing import Callable, Deque, Optional, Tuple

import rospy

from ceiling_dso_ros.dso import PinholeCamera
from ceiling_dso_ros.msg import KeyframeView as KeyframeViewMessage
from ceiling_dso_ros.playback.keyframe_recorder import KeyframeRecorder
from ceiling_dso_ros.playback.visual_run import TrackedImage
from ceiling_dso_ros.ros.keyframe_messages import view_message
from ceiling_dso_ros.ros.node import publishing

MOST_WAITING = 100  # images; beyond that the keyframes of the window are given up


class ViewPublisher:
    """The topic `visual_odometry/views`, by a thread of its own: the tracking only hands its images over.

    Args:
        data_ns: converts a stamp of the odometry into that of the data, nanoseconds.
    """

    def __init__(self, data_ns: Callable[[int], int]) -> None:
        self._data_ns = data_ns
        self._publisher = rospy.Publisher("visual_odometry/views", KeyframeViewMessage, queue_size=50)
        self._condition = threading.Condition()
        self._waiting: Deque[Tuple[TrackedImage, PinholeCamera, str]] = deque()
        self._recorder: Optional[KeyframeRecorder] = None
        threading.Thread(target=self._go_on, name="views", daemon=True).start()

    def add(self, tracked: TrackedImage, camera: PinholeCamera, camera_frame_id: str) -> None:
        """Hand over an image with its result, and the camera of the undistorted images."""
        with self._condition:
            is_full = len(self._waiting) >= MOST_WAITING
            if self._publisher.get_num_connections() == 0 or is_full:
                self._forget()
                if is_full:
                    rospy.logwarn_throttle(5.0, "the computer is too slow for the map: keyframes are left out")
                return
            self._waiting.append((tracked, camera, camera_frame_id))
            self._condition.notify()

    def reset(self) -> None:
        """Forget the keyframes of the window: the odometry begins anew."""
        with self._condition:
            self._forget()

    def _forget(self) -> None:
        self._waiting.clear()
        self._recorder = None

    def _go_on(self) -> None:
        while not rospy.is_shutdown():
            with self._condition:
                self._condition.wait_for(lambda: bool(self._waiting))
                tracked, camera, camera_frame_id = self._waiting.popleft()
                if self._recorder is None or self._recorder.camera != camera:
                    self._recorder = KeyframeRecorder(camera)
                recorder = self._recorder
            try:
                for view in recorder.add(tracked.image, tracked.status):
                    with publishing():
                        self._publisher.publish(view_message(view, self._data_ns(view.stamp_ns), camera_frame_id))
            except Exception as error:  # a map is not worth the odometry
                rospy.logerr_throttle(5.0, f"a keyframe was not handed over: {type(error).__name__}: {error}")
