"""The server behind dso_node: live images in, visual odometry out."""

import math
import time
from pathlib import Path
from typing import Optional, Tuple, Union

import rospy
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import Header

from ceiling_dso_ros.dso import DirectOdometry
from ceiling_dso_ros.io.camera_models import CameraCalibration, calibration_from_camera_info, read_camera_file
from ceiling_dso_ros.io.errors import FrameError, InputError
from ceiling_dso_ros.io.preprocessing import ImagePreprocessor
from ceiling_dso_ros.io.stamps import seconds
from ceiling_dso_ros.msg import Exposure, VisualOdometryStatus
from ceiling_dso_ros.ros.conversions import image_array, no_pose_message, status_message
from ceiling_dso_ros.ros.exposures import ExposureLookup
from ceiling_dso_ros.ros.mailbox import Mailbox
from ceiling_dso_ros.ros.odometry_publisher import OdometryPublisher
from ceiling_dso_ros.settings import load_settings

QUEUE_SIZE = 50  # every image reaches the mailbox, which keeps the newest and counts the others
BUFFER_BYTES = 2**24  # several images; with rospy's 64 kB old ones would wait unseen in the socket
EXPOSURE_TIMEOUT_S = 0.05
WARNING_PERIOD_S = 5.0

AnyImage = Union[Image, CompressedImage]


class DsoServer:
    """Tracks a camera by Direct Sparse Odometry.

    Subscribes:
        image (sensor_msgs/Image, or image/compressed, sensor_msgs/CompressedImage): the newest wins.
        camera_info (sensor_msgs/CameraInfo): waited for unless ~calibration is given.
        exposure (ceiling_dso_ros/Exposure): optional, matched to the image by stamp.

    Publishes:
        visual_odometry/odometry (nav_msgs/Odometry): T_world_camera in VO units, never metres; the pose's variances are
            9999 while tracking is lost, the twist's always.
        visual_odometry/pose (geometry_msgs/PoseStamped): the same pose, only while tracking.
        visual_odometry/path (nav_msgs/Path): the poses of the current segment.
        visual_odometry/keyframes (Keyframes): the window as refined, whenever it changed.
        visual_odometry/status (VisualOdometryStatus): one for every image that was not dropped.

    Parameters (private, read at start; cfg/Dso.cfg has those that may change while running):
        image_transport: raw (default) or compressed.
        calibration: camera.txt in the TUM-mono layout, instead of camera_info; empty by default.
        rectified: images are those that P of camera_info describes, not K and D; false by default.
        settings: yaml file with settings of the odometry; empty by default.
        frame_id: world of the visual odometry; vo by default.
        camera_frame_id: optical frame of the camera; that of the images by default.
    """

    def __init__(self) -> None:
        """Read the parameters and connect.

        Raises:
            InputError: a parameter, or a file that it names, is wrong.
        """
        transport = rospy.get_param("~image_transport", "raw")
        if transport not in ("raw", "compressed"):
            raise InputError(f"{rospy.resolve_name('~image_transport')}: '{transport}' is not raw or compressed")
        settings_file = rospy.get_param("~settings", "")
        self._config = load_settings(Path(settings_file) if settings_file else None, [])
        self._frame_id = rospy.get_param("~frame_id", "vo")
        self._camera_frame_id = rospy.get_param("~camera_frame_id", "")
        self._rectified = rospy.get_param("~rectified", False)
        calibration_file = rospy.get_param("~calibration", "")

        self._mailbox = Mailbox()
        self._exposures = ExposureLookup()
        self._images = self._dropped = self._rejected = 0
        self._state = VisualOdometryStatus.WAITING
        self._last_stamp: Optional[rospy.Time] = None
        self._camera_info: Tuple = ()  # as last received
        self._calibration: Optional[CameraCalibration] = None  # the newest, set by the thread of camera_info
        self._used_calibration: Optional[CameraCalibration] = None  # what the next two were made from
        self._preprocess: Optional[ImagePreprocessor] = None
        self._odometry: Optional[DirectOdometry] = None
        self._publisher = OdometryPublisher()

        if calibration_file:
            self._calibration = read_camera_file(calibration_file)
        else:
            rospy.Subscriber("camera_info", CameraInfo, self._on_camera_info, queue_size=1)
        self._exposure_subscriber = rospy.Subscriber("exposure", Exposure, self._on_exposure, queue_size=QUEUE_SIZE)
        # Resolved first: a remapped image takes its compressed topic along.
        self._image_topic = rospy.resolve_name("image") + ("" if transport == "raw" else "/compressed")
        image_type = Image if transport == "raw" else CompressedImage
        rospy.Subscriber(self._image_topic, image_type, self._on_image, queue_size=QUEUE_SIZE, buff_size=BUFFER_BYTES)

    def spin(self) -> None:
        """Work until the node is shut down."""
        while not rospy.is_shutdown():
            message = self._mailbox.take(timeout_s=0.1)
            if message is not None:
                self._process(message)

    def _on_image(self, message: AnyImage) -> None:
        self._images += 1
        self._dropped += self._mailbox.put(message)

    def _on_exposure(self, message: Exposure) -> None:
        if math.isfinite(message.exposure_ms):
            self._exposures.add(message.header.stamp.to_nsec(), message.exposure_ms)

    def _on_camera_info(self, message: CameraInfo) -> None:
        fields = (message.width, message.height, message.distortion_model, message.D, message.K, message.P)
        if fields == self._camera_info:
            return
        self._camera_info = fields
        topic = rospy.resolve_name("camera_info")
        try:
            self._calibration = calibration_from_camera_info(*fields, self._rectified, source=topic)
        except InputError as error:
            rospy.logwarn_throttle(WARNING_PERIOD_S, f"ignored: {error}")

    def _process(self, message: AnyImage) -> None:
        start_s = time.perf_counter()
        header = Header(stamp=message.header.stamp, frame_id=self._frame_id)
        try:
            status = self._track(message, header)
        except FrameError as error:
            self._rejected += 1
            rospy.logwarn_throttle(WARNING_PERIOD_S, f"{self._image_topic}: image skipped: {error}")
            status = no_pose_message(header, self._state, str(error))
        self._state = status.state
        status.processing_ms = 1e3 * (time.perf_counter() - start_s)
        status.images, status.dropped, status.rejected = self._images, self._dropped, self._rejected
        self._publisher.publish_status(status)

    def _track(self, message: AnyImage, header: Header) -> VisualOdometryStatus:
        """Hand an image to the odometry and publish the pose.

        Raises:
            FrameError: the image is unusable.
        """
        if self._calibration is not self._used_calibration:
            self._use(self._calibration)
        if self._odometry is None:
            waiting = f"waiting for a calibration on {rospy.resolve_name('camera_info')}"
            rospy.logwarn_throttle(WARNING_PERIOD_S, waiting)
            return no_pose_message(header, VisualOdometryStatus.WAITING, waiting)
        image = self._preprocess(image_array(message))
        self._check_order(message.header.stamp)
        stamp_ns = message.header.stamp.to_nsec()
        timeout_s = EXPOSURE_TIMEOUT_S if self._exposure_subscriber.get_num_connections() > 0 else 0.0
        status = self._odometry.track(image, seconds(stamp_ns), self._exposures.at(stamp_ns, timeout_s))
        self._publisher.publish(header, self._camera_frame_id or message.header.frame_id, status)
        return status_message(header, status)

    def _use(self, calibration: CameraCalibration) -> None:
        """Start anew with a calibration."""
        if self._used_calibration is not None:
            rospy.logwarn("the camera's calibration changed: starting anew")
        self._used_calibration = calibration
        self._preprocess = ImagePreprocessor(calibration)
        self._odometry = DirectOdometry(self._preprocess.camera, self._config)
        self._publisher.reset()
        rospy.loginfo(f"tracking images of {calibration.lens} as {self._preprocess.camera}")

    def _check_order(self, stamp: rospy.Time) -> None:
        """Start anew when time goes backwards, as it does when a bag is played again.

        Raises:
            FrameError: the stamp is that of the last image.
        """
        last, self._last_stamp = self._last_stamp, stamp
        if last is None or stamp > last:
            return
        if stamp == last:
            raise FrameError(f"the stamp {seconds(stamp.to_nsec()):.9f} is that of the image before")
        rospy.logwarn(f"time went backwards by {(last - stamp).to_sec():.3f} s: starting anew")
        self._odometry.reset()
        self._publisher.reset()
