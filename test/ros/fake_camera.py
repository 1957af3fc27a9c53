# SPDX-License-Identifier: BSD-3-Clause
"""A camera that looks at a textured plane and moves to and fro, in real time; for the rostests of dso_node."""

import threading

import numpy as np
import rospy
from dso_node_player import image_message
from sensor_msgs.msg import CameraInfo, Image

from ceiling_dso_ros.dso import PinholeCamera
from ceiling_dso_ros.dso.warmup import textured_plane

CAMERA = PinholeCamera(200.0, 200.0, 159.5, 119.5, 320, 240)
HZ, VIEWS, STEP = 15.0, 60, 0.012


class FakeCamera:
    """Publishes while the context lasts.

    Attributes:
        images: whether images are published.
        pixels: what to show instead of the plane, (H, W) uint8, or None.
        focal_px: of the camera_info.
        shift_ns: what is added to all stamps.
    """

    def __init__(self):
        self.images, self.pixels, self.focal_px, self.shift_ns = True, None, CAMERA.fx, 0
        self._views = [textured_plane(CAMERA, STEP * view).clip(0, 255).astype(np.uint8) for view in range(VIEWS)]
        self._image = rospy.Publisher("camera/up/image_raw", Image, queue_size=10)
        self._camera_info = rospy.Publisher("camera/up/camera_info", CameraInfo, queue_size=10)
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._work, daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._end.set()
        self._thread.join()

    def image(self):
        """An image of now."""
        return image_message(self._views[0], rospy.Time.now().to_nsec() + self.shift_ns)

    def send(self, image):
        """Publish any image."""
        self._image.publish(image)

    def _work(self):
        number = 0
        while not self._end.wait(1.0 / HZ):
            if not self.images:
                continue
            phase = number % (2 * VIEWS - 2)
            number += 1
            view = self._views[min(phase, 2 * VIEWS - 2 - phase)] if self.pixels is None else self.pixels
            stamp_ns = rospy.Time.now().to_nsec() + self.shift_ns
            K = [self.focal_px, 0.0, CAMERA.cx, 0.0, self.focal_px, CAMERA.cy, 0.0, 0.0, 1.0]
            self._camera_info.publish(
                CameraInfo(width=CAMERA.width, height=CAMERA.height, K=K, distortion_model="plumb_bob", D=[0.0] * 5)
            )
            self._image.publish(image_message(view, stamp_ns))
