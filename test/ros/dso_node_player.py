# SPDX-License-Identifier: BSD-3-Clause
"""Plays images to a running dso_node and collects what it publishes; for the rostests."""

import threading

import rospy
from nav_msgs.msg import Odometry, Path
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import Header
from waiting import wait_until

from ceiling_dso_ros.msg import Exposure, Keyframes, VisualOdometryStatus

TIMEOUT_S = 120.0  # the first image may have to wait for compilation


def image_message(pixels, stamp_ns, encoding="mono8"):
    """sensor_msgs/Image of (H, W) or (H, W, channels)."""
    height, width = pixels.shape[:2]
    return Image(_header(stamp_ns), height, width, encoding, 0, pixels.nbytes // height, pixels.tobytes())


def compressed_message(data, stamp_ns):
    """sensor_msgs/CompressedImage of the bytes of a JPEG file."""
    return CompressedImage(_header(stamp_ns), "jpeg", data)


def _header(stamp_ns):
    return Header(stamp=rospy.Time(0, stamp_ns), frame_id="camera")


class Player:
    """Publishers and subscribers around dso_node in this namespace."""

    def __init__(self, image_topic="camera/up/image_raw", image_type=Image):
        self.statuses, self.odometry, self.keyframes, self.paths = [], [], [], []
        self._arrived = threading.Condition()
        self._subscribers = [
            rospy.Subscriber("visual_odometry/odometry", Odometry, self.odometry.append),
            rospy.Subscriber("visual_odometry/keyframes", Keyframes, self.keyframes.append),
            rospy.Subscriber("visual_odometry/path", Path, self.paths.append),
            rospy.Subscriber("visual_odometry/status", VisualOdometryStatus, self._on_status),
        ]
        self._image = rospy.Publisher(image_topic, image_type, queue_size=1000)
        self._camera_info = rospy.Publisher("camera/up/camera_info", CameraInfo, queue_size=10)
        self._exposure = rospy.Publisher("camera/up/exposure", Exposure, queue_size=1000)
        ends = [*self._subscribers, self._image, self._camera_info, self._exposure]
        wait_until(lambda: all(end.get_num_connections() > 0 for end in ends), "dso_node is not connected")

    def send(self, image):
        """Publish an image without waiting."""
        self._image.publish(image)

    def play(self, image, exposure_ms=None):
        """Publish an image and return the node's status of it."""
        if exposure_ms is not None:
            self._exposure.publish(Exposure(image.header, exposure_ms))
        count = len(self.statuses)
        self.send(image)
        self.wait_for_statuses(count + 1)
        return self.statuses[-1]

    def calibrate(self, width, height, fx, fy, cx, cy, **fields):
        """Publish the camera_info of a pinhole, with further fields."""
        K = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
        fields = {"distortion_model": "plumb_bob", "D": [0.0] * 5, **fields}
        self._camera_info.publish(CameraInfo(width=width, height=height, K=K, **fields))

    def wait_for_statuses(self, count):
        """Wait until that many statuses have arrived."""
        with self._arrived:
            if not self._arrived.wait_for(lambda: len(self.statuses) >= count, TIMEOUT_S):
                raise TimeoutError(f"{len(self.statuses)} statuses instead of {count}")

    def _on_status(self, status):
        with self._arrived:
            self.statuses.append(status)
            self._arrived.notify_all()
