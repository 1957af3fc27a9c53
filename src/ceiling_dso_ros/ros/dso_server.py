# SPDX-License-Identifier: BSD-3-Clause
"""The server behind dso_node: live images in, visual odometry out."""

import threading
import time
import traceback
from dataclasses import replace
from typing import Dict, Optional, Tuple, Union

import rospy
from diagnostic_updater import DiagnosticStatusWrapper
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import Header

from ceiling_dso_ros.cfg import DsoConfig
from ceiling_dso_ros.dso import CameraMotion, ConfigError, OdometryConfig, OdometryStatus, warmup
from ceiling_dso_ros.dso.compute.schedulers import LiveScheduler, SequentialScheduler
from ceiling_dso_ros.dso.mapping.map_snapshot import NO_POINTS
from ceiling_dso_ros.io.camera_models import CameraCalibration
from ceiling_dso_ros.io.errors import FrameError, InputError, one_line
from ceiling_dso_ros.io.frame_rate import FrameRateLimit, parse_frame_rate
from ceiling_dso_ros.io.image_scaling import parse_image_size
from ceiling_dso_ros.io.recording import SecondCamera
from ceiling_dso_ros.io.stamps import format_stamp
from ceiling_dso_ros.msg import MotionPrediction, VisualOdometryStatus
from ceiling_dso_ros.playback.camera_spool import CameraSpool
from ceiling_dso_ros.playback.visual_run import TrackedImage, VisualRun
from ceiling_dso_ros.ros import diagnostics, dso_report, parameters
from ceiling_dso_ros.ros.calibration_input import CalibrationInput
from ceiling_dso_ros.ros.conversions import image_array, no_pose_message, status_message
from ceiling_dso_ros.ros.data_clock import StampKind
from ceiling_dso_ros.ros.exposure_input import ExposureInput
from ceiling_dso_ros.ros.kernels import load_kernels
from ceiling_dso_ros.ros.mailbox import Mailbox
from ceiling_dso_ros.ros.map_publisher import MapPublisher
from ceiling_dso_ros.ros.motion_predictions import MotionPredictions
from ceiling_dso_ros.ros.node import publishing
from ceiling_dso_ros.ros.node_parameters import DsoParameters
from ceiling_dso_ros.ros.odometry_publisher import OdometryPublisher
from ceiling_dso_ros.ros.reconfigure import ReconfigureServer
from ceiling_dso_ros.ros.right_input import RightInput
from ceiling_dso_ros.ros.run_clock import RunClock
from ceiling_dso_ros.ros.services import offer_trigger
from ceiling_dso_ros.ros.trajectory_keeper import TrajectoryKeeper
from ceiling_dso_ros.ros.view_publisher import ViewPublisher

QUEUE_SIZE = 50  # every image reaches the mailbox, which leaves some out where the odometry does not keep up
BUFFER_BYTES = 2**24  # several images; with rospy's default of 64 kB, old images would wait in the socket
CALIBRATION_TIMEOUT_S = 0.3  # the first image and its camera_info come over different connections
WARNING_PERIOD_S = 5.0
LEFT_OUT = "left out: hardly anything has moved"

AnyImage = Union[Image, CompressedImage]


class DsoServer:
    """Tracks a camera by Direct Sparse Odometry.

    Subscribes:
        image (sensor_msgs/Image, or image/compressed, sensor_msgs/CompressedImage): only the newest image is processed.
        camera_info (sensor_msgs/CameraInfo): required unless ~calibration is given.
        exposure (ceiling_dso_ros/Exposure): optional, matched to the image by stamp.
        metadata (realsense2_camera/Metadata): optional, the exposures of Intel's driver realsense-ros.
        right/image, right/camera_info, /tf_static: optional, a second camera, which tells the scale of keyframes.
        fusion/motion_prediction (MotionPrediction): with ~motion_prediction.

    Publishes:
        visual_odometry/odometry (nav_msgs/Odometry): T_world_camera in VO units, never metres; the pose's variances are
            9999 while tracking is lost, the twist's always.
        visual_odometry/pose (geometry_msgs/PoseStamped): the same pose, only while tracking.
        visual_odometry/path (nav_msgs/Path): the poses of the current segment.
        visual_odometry/status (VisualOdometryStatus): one for every image that was not dropped, with the window's
            keyframes where they changed.
        visual_odometry/keyframes (Keyframes): these keyframes alone, latched.
        visual_odometry/points (sensor_msgs/PointCloud2): the window's points, when it changed and somebody listens.
        visual_odometry/debug_image (sensor_msgs/Image): the image with the points, when somebody listens.
        visual_odometry/views (KeyframeView): what keyframes show that have left the window, when somebody listens.
        /diagnostics

    Services:
        ~reset (std_srvs/Trigger): forget everything; the next image starts segment 0.
        ~pause, ~resume (std_srvs/Trigger): images in between are ignored.
        ~save_trajectory (SaveTrajectory): write camera.tum, camera_final.tum and keyframes.tum, see `TrajectoryKeeper`.

    Parameters (private, read at start): `DsoParameters` and `OdometryConfig`; cfg/Dso.cfg has those that may change
        while running.
    """

    def __init__(self) -> None:
        """Read the parameters, load the compiled kernels and connect.

        Raises:
            InputError: a parameter, or a file that it names, is wrong.
        """
        self._parameters, self._config = parameters.read(DsoParameters, OdometryConfig)
        own: DsoParameters = self._parameters
        self._frame_id, self._camera_frame_id = own.vo_frame.lstrip("/"), own.camera_frame.lstrip("/")
        self._size = parse_image_size(own.image_size, "image_size") if own.image_size else None

        self._lock = threading.Lock()  # of the odometry, between the worker and the services
        self._frame_rate, self._regulated = FrameRateLimit(), False
        self._mailbox = Mailbox()
        self._exposures = ExposureInput()
        self._images = diagnostics.Stream(own.silence)
        self._dropped, self._left_out, self._paused = 0, 0, False
        self._status = VisualOdometryStatus(state=VisualOdometryStatus.WAITING, message="no image yet")
        self._clock = RunClock()
        self._calibration: Optional[CameraCalibration] = None  # of the run
        self._size_complaint = ""
        self._run: Optional[VisualRun] = None  # None without a calibration
        self._scheduler = LiveScheduler() if own.mapping == "live" else SequentialScheduler()

        self._calibrations = CalibrationInput(parameters.file_path(own.calibration), own.rectified)
        self._right = RightInput(own.image_transport, own.rectified)
        self._second: Optional[SecondCamera] = None  # of the run
        self._keeper = TrajectoryKeeper(own, CameraSpool, self._newest_results)
        load_kernels(warmup.load_kernels)
        self._predictions = MotionPredictions() if own.motion_prediction else None
        self._publisher, self._map = OdometryPublisher(), MapPublisher()
        self._views = ViewPublisher(self._clock.stamp_ns)
        self._reconfigure_server = ReconfigureServer(DsoConfig, self._reconfigure)
        self._offer_services()
        diagnostics.Diagnostics(self._report, "camera")
        self._connect(own.image_transport)

    def spin(self) -> None:
        """Work until the node is shut down."""
        rospy.on_shutdown(self._mailbox.close)
        while (message := self._mailbox.take()) is not None:
            with self._lock:
                self._process_safely(message)
        self._scheduler.close()
        self._keeper.end()

    def _offer_services(self) -> None:
        offer_trigger("~reset", self._reset)
        offer_trigger("~pause", lambda: self._pause(True))
        offer_trigger("~resume", lambda: self._pause(False))
        self._keeper.offer_service()

    def _connect(self, transport: str) -> None:
        if self._predictions is not None:
            add = self._predictions.add
            rospy.Subscriber("fusion/motion_prediction", MotionPrediction, add, queue_size=10, tcp_nodelay=True)
        # Resolved first: a remapped image takes its compressed topic along.
        self._image_topic = rospy.resolve_name("image") + ("" if transport == "raw" else "/compressed")
        image_type = Image if transport == "raw" else CompressedImage
        rospy.Subscriber(self._image_topic, image_type, self._on_image, queue_size=QUEUE_SIZE, buff_size=BUFFER_BYTES)

    # Input

    def _on_image(self, message: AnyImage) -> None:
        self._images.heard()
        stamp = message.header.stamp
        if not self._paused and (stamp.is_zero() or self._frame_rate.passes(stamp.to_nsec())):
            self._dropped += self._mailbox.put(message)

    # Work

    def _process_safely(self, message: AnyImage) -> None:
        """An error that is not of the odometry, such as one of publishing, concerns one image only."""
        try:
            with publishing():
                self._process(message)
        except Exception:
            rospy.logerr_throttle(WARNING_PERIOD_S, f"an image was not processed: {traceback.format_exc()}")

    def _process(self, message: AnyImage) -> None:
        start_s = time.perf_counter()
        header = Header(stamp=message.header.stamp, frame_id=self._frame_id)
        if self._leaves_out(message.header.stamp.to_nsec()):
            self._left_out += 1
            self._say(no_pose_message(header, self._status, LEFT_OUT), message, start_s)
            return
        tracked: Optional[TrackedImage] = None
        try:
            status, tracked = self._track(message, header)
        except FrameError as error:
            self._images.complain(str(error))
            rospy.logwarn_throttle(WARNING_PERIOD_S, one_line(f"{self._image_topic}: image skipped: {error}"))
            status = no_pose_message(header, self._status, str(error))
        except Exception as error:  # an error with one image must not end the node while the robot drives
            rospy.logerr("the odometry failed and is restarted: %s", traceback.format_exc())
            self._start_anew()
            lost = VisualOdometryStatus(state=VisualOdometryStatus.LOST)
            status = no_pose_message(header, lost, one_line(f"failed: {type(error).__name__}: {error}"))
        self._status = status
        self._say(status, message, start_s)
        if tracked is not None and self._run is not None:  # for display and the map, so after what the robot waits for
            self._views.add(tracked, self._run.odometry.camera, status.camera_frame_id)
            self._show(header, status.camera_frame_id, tracked)

    def _leaves_out(self, stamp_ns: int) -> bool:
        """Whether an image is not used, because hardly anything has moved; it is not even decoded then."""
        if self._run is None or self._run.regulation is None:
            return False
        return self._run.leaves_out(self._clock.inner_ns(stamp_ns), self._prediction(stamp_ns))

    def _say(self, status: VisualOdometryStatus, message: AnyImage, start_s: float) -> None:
        """Publish the status of an image, with all that is not of the odometry."""
        status.camera_frame_id = self._camera_frame(message)
        status.processing_ms = 1e3 * (time.perf_counter() - start_s)
        status.images, status.dropped, status.rejected = self._images.received, self._dropped, self._images.rejected
        status.left_out = self._left_out
        regulation = None if self._run is None else self._run.regulation
        if regulation is not None:
            status.rate_reason = regulation.reason
            status.rate = regulation.rate_hz(self._clock.inner_ns(message.header.stamp.to_nsec()))
        self._publisher.publish_status(status)

    def _track(self, message: AnyImage, header: Header) -> Tuple[VisualOdometryStatus, Optional[TrackedImage]]:
        """Track an image and publish the pose; returns the status, and the image if it was tracked.

        Raises:
            FrameError: the image is unusable.
        """
        image, stamp_ns = image_array(message), message.header.stamp.to_nsec()
        calibration = self._calibrations.newest(CALIBRATION_TIMEOUT_S, (image.shape[1], image.shape[0]))
        second = self._right.camera(self._camera_frame(message), CALIBRATION_TIMEOUT_S)
        if calibration is not None and (calibration != self._calibration or second is not self._second):
            calibration.require_size_of(image)  # a wrong one may not cost the map, nor memory for other images
            self._use(calibration, second)
        if self._run is None:
            waiting = self._size_complaint or f"waiting for a calibration on {rospy.resolve_name('camera_info')}"
            rospy.logwarn_throttle(WARNING_PERIOD_S, waiting)
            return no_pose_message(header, VisualOdometryStatus(state=VisualOdometryStatus.WAITING), waiting), None
        self._run.preprocess.check(image)  # before its stamp counts
        inner_ns = self._take_stamp(stamp_ns)
        exposure_ms, prediction = self._exposures.at(stamp_ns), self._prediction(stamp_ns)
        tracked = self._run.track(image, inner_ns, exposure_ms, prediction, self._right.later(stamp_ns))
        if self._keeper.spool is not None:
            self._keeper.spool.add(tracked.status)
        status = self._with_data_stamps(tracked.status)
        with publishing():
            self._publisher.publish(header, self._camera_frame(message), status)
        return status_message(header, status), tracked

    def _show(self, header: Header, camera_frame_id: str, tracked: TrackedImage) -> None:
        if self._run is not None and self._map.wants(tracked.status):
            odometry = self._run.odometry
            points = NO_POINTS if odometry.map is None else odometry.map.points
            self._map.publish(header, camera_frame_id, tracked.image, odometry.camera, tracked.status, points)

    def _prediction(self, stamp_ns: int) -> Optional[CameraMotion]:
        if self._predictions is None or self._status.predict_from.is_zero():
            return None
        return self._predictions.between(self._status.predict_from.to_nsec(), stamp_ns, self._status.segment)

    def _camera_frame(self, message: AnyImage) -> str:
        return self._camera_frame_id or message.header.frame_id.lstrip("/")

    def _use(self, calibration: CameraCalibration, second: Optional[SecondCamera]) -> None:
        """Restart with a calibration, and a second camera if there is one."""
        if self._calibration is not None:
            rospy.logwarn("the calibration of a camera changed: restarting")
        self._calibration, self._second, self._run = calibration, second, None
        self._scheduler.discard()
        own: DsoParameters = self._parameters
        try:
            self._run = VisualRun.of_camera(
                calibration,
                config=self._config,
                scheduler=self._scheduler,
                size=self._size,
                bits=own.bit_depth,
                tell=rospy.logwarn,
                keep_trajectory=False,  # the keeper has it
                second=second,
            )
        except (ConfigError, InputError) as error:
            self._size_complaint = one_line(f"cannot track: {error}")
            return
        self._size_complaint = ""
        self._run.regulate(self._regulated)
        self._start_anew()
        rospy.loginfo(f"tracking images of {calibration.lens} as {self._run.odometry.camera}")

    def _take_stamp(self, stamp_ns: int) -> int:
        """Check the order of an image's stamp; restart if a bag is played again.

        Returns:
            Its time on the inner clock, nanoseconds.

        Raises:
            FrameError: there is no stamp, it is not later than that of the last image, or it is not believed.
        """
        if stamp_ns == 0:
            raise FrameError("it has no stamp")
        kind = self._clock.follow(stamp_ns, self._start_anew)
        if kind in (StampKind.REPEATED, StampKind.LATE, StampKind.DOUBTED):
            raise FrameError(f"the stamp {format_stamp(stamp_ns)} is {kind.value}")
        return self._clock.inner_ns(stamp_ns)

    def _with_data_stamps(self, status: OdometryStatus) -> OdometryStatus:
        """The status with the original stamps of the images, if the clock was set back since."""
        keyframes = tuple(replace(k, stamp_ns=self._clock.stamp_ns(k.stamp_ns)) for k in status.keyframes)
        stamp_ns, start_ns = (self._clock.stamp_ns(inner) for inner in (status.stamp_ns, status.predict_from_ns))
        return replace(status, stamp_ns=stamp_ns, keyframes=keyframes, earlier_start_ns=start_ns)

    def _start_anew(self) -> None:
        if self._run is not None:
            self._run.restart()
        self._clock.reset()
        self._keeper.clear()
        self._publisher.reset()
        self._views.reset()

    def _reconfigure(self, settings: DsoConfig, _level: int) -> DsoConfig:
        frame_rate = parse_frame_rate(settings.frame_rate, "frame_rate=")
        self._frame_rate.frame_rate, self._regulated = frame_rate or 0.0, frame_rate is None
        with self._lock:
            if self._run is not None:
                self._run.regulate(self._regulated)
        self._publisher.covariance_scale = settings.covariance_scale
        self._publisher.path.length, self._publisher.path.period_s = settings.path_length, settings.path_period
        self._map.period_s = settings.map_period
        return settings

    # Services

    def _reset(self) -> str:
        with self._lock:
            self._start_anew()
        return "the next image starts segment 0"

    def _pause(self, paused: bool) -> str:
        self._paused = paused
        return "paused" if paused else "resumed"

    def _newest_results(self, spool: CameraSpool) -> Dict[str, bytes]:
        with self._lock:
            return spool.newest()

    # Diagnostics

    def _report(self, report: DiagnosticStatusWrapper) -> DiagnosticStatusWrapper:
        inputs = (self._calibrations, self._keeper, self._exposures, self._right)
        complaints = tuple(each.complaint for each in inputs)
        dso_report.summarize(report, self._status, self._paused, complaints)
        self._images.judge(report, self._image_topic)
        report.add("dropped", str(self._dropped))
        left_out = self._left_out if self._regulated else None
        dso_report.add_figures(report, self._status, left_out, self._keeper.lost, self._predictions)
        return report
