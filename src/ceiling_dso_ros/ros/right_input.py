# SPDX-License-Identifier: BSD-3-Clause
"""The second camera for dso_node: its images by their stamps, its calibration, and where it is."""

import threading
from collections import deque
from typing import Callable, Deque, Optional, Tuple, Union

import numpy as np
import rospy
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from tf2_msgs.msg import TFMessage

from ceiling_dso_ros.io.camera_info import calibration_from_camera_info, camera_info_fields
from ceiling_dso_ros.io.errors import FrameError, InputError, one_line
from ceiling_dso_ros.io.photometric import PhotometricCalibration
from ceiling_dso_ros.io.recording import SecondCamera
from ceiling_dso_ros.io.second_camera import PAIRED_NS, pose_of_right
from ceiling_dso_ros.io.static_transforms import StaticTransforms
from ceiling_dso_ros.ros.conversions import image_array
from ceiling_dso_ros.ros.waiting import wait_until

KEPT_NS = 10**9  # images: those that come all at once wait for the odometry, and keyframes for the mapping
MOST_KEPT = 100
QUEUE_SIZE = 10
TIMEOUT_S = 0.1  # for the image of the same moment, which comes over another connection
BUFFER_BYTES = 2**24

AnyImage = Union[Image, CompressedImage]


class RightInput:
    """The topics `right/image` and `right/camera_info`, and /tf_static; all optional.

    Attributes:
        complaint: why the images are not used; empty if they are, or if there are none.
    """

    def __init__(self, transport: str, rectified: bool) -> None:
        """Subscribe; the arguments are ~image_transport and ~rectified."""
        self.complaint = ""
        self._rectified = rectified
        self._lock = threading.Lock()
        self._images: Deque[Tuple[int, AnyImage]] = deque(maxlen=MOST_KEPT)
        self._info: Optional[CameraInfo] = None
        self._transforms = StaticTransforms()
        self._known: Tuple[object, ...] = ()
        self._camera: Optional[SecondCamera] = None
        topic = rospy.resolve_name("right/image") + ("" if transport == "raw" else "/compressed")
        kind = Image if transport == "raw" else CompressedImage
        self._subscriber = rospy.Subscriber(topic, kind, self._on_image, queue_size=QUEUE_SIZE, buff_size=BUFFER_BYTES)
        rospy.Subscriber("right/camera_info", CameraInfo, self._on_info, queue_size=1)
        rospy.Subscriber("/tf_static", TFMessage, self._on_transforms, queue_size=100)

    def camera(self, left_frame: str, timeout_s: float) -> Optional[SecondCamera]:
        """The second camera; None without one, or while something is missing. The same object while nothing changes.

        Args:
            left_frame: optical frame of the first camera.
            timeout_s: how long to wait for the first camera_info, if there are images.
        """
        if self._subscriber.get_num_connections() == 0:
            return self._camera
        wait_until(lambda: self._info is not None and bool(self._images), 0.0 if self._known else timeout_s)
        with self._lock:
            if self._info is None or not self._images:
                return self._camera
            fields, frame = camera_info_fields(self._info), self._images[-1][1].header.frame_id.lstrip("/")
            T = self._transforms.lookup(left_frame, frame) if frame and frame != left_frame else None
            known = (tuple(fields.values()), None if T is None else T.tobytes())
            if known != self._known:
                self._known = known
                self._read(fields, T)
            return self._camera

    def later(self, stamp_ns: int) -> Optional[Callable[[], np.ndarray]]:
        """Gives the image of the second camera with the stamp of one of the first; None if nobody publishes any."""
        if self._camera is None or self._subscriber.get_num_connections() == 0:
            return None
        return lambda: self._image(stamp_ns)

    def _image(self, stamp_ns: int) -> np.ndarray:
        wait_until(lambda: self._at(stamp_ns) is not None, TIMEOUT_S)
        message = self._at(stamp_ns)
        if message is None:
            raise FrameError("the second camera has no image of this moment")
        return image_array(message)

    def _at(self, stamp_ns: int) -> Optional[AnyImage]:
        with self._lock:
            images = list(self._images)
        return next((image for other_ns, image in images if abs(other_ns - stamp_ns) <= PAIRED_NS), None)

    def _read(self, fields: dict, T: Optional[np.ndarray]) -> None:
        topic = rospy.resolve_name("right/camera_info")
        try:
            calibration = calibration_from_camera_info(**fields, rectified=self._rectified, source=topic)
            pose = pose_of_right(T, fields["P"], topic)
            self._camera, self.complaint = SecondCamera(calibration, PhotometricCalibration.linear(), pose), ""
        except InputError as error:
            self._camera, self.complaint = None, one_line(f"the second camera is not used: {error}")
            rospy.logwarn(self.complaint)

    def _on_image(self, message: AnyImage) -> None:
        with self._lock:
            newest_ns = message.header.stamp.to_nsec()
            self._images.append((newest_ns, message))
            while abs(newest_ns - self._images[0][0]) > KEPT_NS:
                self._images.popleft()

    def _on_info(self, message: CameraInfo) -> None:
        with self._lock:
            self._info = message

    def _on_transforms(self, message: TFMessage) -> None:
        with self._lock:
            self._transforms.add(message)
