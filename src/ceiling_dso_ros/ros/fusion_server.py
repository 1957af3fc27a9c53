# SPDX-License-Identifier: BSD-3-Clause
"""The server of fusion_node: fuses wheel odometry and visual odometry into the robot's metric pose."""

import threading
import time
from dataclasses import fields, replace
from typing import Dict, Optional

import numpy as np
import rospy
from diagnostic_updater import DiagnosticStatusWrapper
from nav_msgs.msg import Odometry

from ceiling_dso_ros.cfg import FusionConfig as FusionReconfigureConfig
from ceiling_dso_ros.cfg import FusionOutputConfig
from ceiling_dso_ros.dso import OdometryStatus
from ceiling_dso_ros.dso.config import ConfigError
from ceiling_dso_ros.dso.durations import nanoseconds
from ceiling_dso_ros.fusion.config import FusionConfig, OutputConfig
from ceiling_dso_ros.fusion.estimator import FusionEstimator
from ceiling_dso_ros.fusion.state import FusedState
from ceiling_dso_ros.fusion.turn_check import TurnCheck
from ceiling_dso_ros.io.errors import one_line
from ceiling_dso_ros.io.limits import LARGEST_SET_M
from ceiling_dso_ros.io.ros_messages import planar_pose
from ceiling_dso_ros.io.stamps import format_stamp
from ceiling_dso_ros.io.wheel_messages import other_body
from ceiling_dso_ros.msg import FusionStatus, Keyframes, VisualOdometryStatus
from ceiling_dso_ros.playback.fusion_spool import FusionSpool
from ceiling_dso_ros.playback.spool import SpoolFolder
from ceiling_dso_ros.ros import diagnostics, fusion_report, parameters
from ceiling_dso_ros.ros.base_transform import BaseTransform
from ceiling_dso_ros.ros.camera_mount import CameraMount
from ceiling_dso_ros.ros.conversions import ros_time
from ceiling_dso_ros.ros.data_clock import StampKind
from ceiling_dso_ros.ros.fusion_publisher import FusionPublisher
from ceiling_dso_ros.ros.image_order import CAMERA_AHEAD_NS, ImageOrder
from ceiling_dso_ros.ros.keyframe_messages import left_messages
from ceiling_dso_ros.ros.metric_map import MetricMap
from ceiling_dso_ros.ros.node import publishing
from ceiling_dso_ros.ros.node_parameters import FusionParameters
from ceiling_dso_ros.ros.reconfigure import ReconfigureServer
from ceiling_dso_ros.ros.robot_parameter import ROBOT_GROUP, read_robot
from ceiling_dso_ros.ros.run_clock import RunClock
from ceiling_dso_ros.ros.services import offer_trigger
from ceiling_dso_ros.ros.trajectory_keeper import TrajectoryKeeper
from ceiling_dso_ros.ros.visual_input import VisualInput
from ceiling_dso_ros.srv import SetPose, SetPoseRequest, SetPoseResponse

QUEUE_SIZE = 200  # every wheel sample and every image counts


class FusionServer:
    """Fuses wheel odometry and visual odometry.

    Subscribes:
        wheel/odometry (nav_msgs/Odometry): from wheel_odometry_node or any other driver.
        visual_odometry/status (VisualOdometryStatus): of dso_node.
        visual_odometry/keyframes (Keyframes): the newest window from before this node started (latched).
        /tf_static, /tf: pose of the camera, unless robot.yaml has it; other publishers of the base's transform.

    Publishes:
        odometry/filtered (nav_msgs/Odometry): base_link in odom, metric, continuous, for every wheel sample; while the
            wheels are silent for every image.
        fusion/scale (FusionScale), fusion/status (FusionStatus): with each pose.
        fusion/path (nav_msgs/Path): the poses so far, every half second, when somebody listens.
        fusion/points (sensor_msgs/PointCloud2), fusion/keyframes (geometry_msgs/PoseArray): what the camera sees now,
            in metres and in odom, when somebody listens.
        fusion/motion_prediction (MotionPrediction): with each pose, when somebody listens.
        fusion/left_keyframes (LeftKeyframe): keyframes that have left the odometry's window, when somebody listens.
        /tf: odom -> base_link, see ~publish_tf and ~tf_mode.
        /diagnostics

    Services:
        ~reset (std_srvs/Trigger): forget everything; the next wheel sample is the origin.
        ~set_pose (SetPose): set the published pose.
        ~save_trajectory (SaveTrajectory): write wheel.tum, fused.tum and fused_smoothed.tum, see `TrajectoryKeeper`.

    Parameters (private, read at start): `FusionParameters`; `FusionConfig`; and robot, which must be given, with
        ticks_per_turn, wheel_radius [left, right] in m, wheel_base in m, optionally T_base_camera {xyz, quat_xyzw} and
        camera_time_offset in s. cfg/Fusion.cfg and cfg/FusionOutput.cfg have those that may change while running.
    """

    def __init__(self) -> None:
        """Read the parameters and connect.

        Raises:
            InputError: a parameter, or a file that it names, is wrong.
        """
        own: FusionParameters
        own, self._config = parameters.read(FusionParameters, FusionConfig, groups=ROBOT_GROUP)
        robot, has_camera = read_robot()
        self._odom_frame, self._base_frame = own.odom_frame.lstrip("/"), own.base_frame.lstrip("/")

        self._lock = threading.Lock()
        self._keeper = TrajectoryKeeper(own, self._begin_spool, self._newest_results)
        self._wheels, self._images = diagnostics.Stream(own.silence), diagnostics.Stream(own.silence)
        self._clock = RunClock()  # clock of the wheels, to which the images' stamps are converted
        self._order = ImageOrder(self._clock.is_simulated)
        self._turns = TurnCheck()
        self._visual = VisualInput(self._clock)
        self._counts = FusionStatus()
        self._mount = CameraMount(self._base_frame, own.camera_frame, robot.T_base_camera if has_camera else None)
        self._camera_known = has_camera
        self._camera_offset_ns = nanoseconds(robot.camera_time_offset_s)
        self._estimator = FusionEstimator(robot, self._config, keep_history=self._keeper.spool is not None)
        self._publisher = FusionPublisher(self._odom_frame, self._base_frame)
        self._map = MetricMap(self._odom_frame)
        self._transform = BaseTransform(own.tf_mode if own.publish_tf else "none", self._odom_frame, self._base_frame)
        self._forget()

        self._reconfigure_servers = (
            ReconfigureServer(FusionReconfigureConfig, self._publisher.reconfigure),
            ReconfigureServer(FusionOutputConfig, self._reconfigure_output, namespace="output"),
        )
        offer_trigger("~reset", self._reset)
        rospy.Service("~set_pose", SetPose, self._set_pose)
        self._keeper.offer_service()
        diagnostics.Diagnostics(self._report, "fusion")
        for topic, kind, callback in (
            ("wheel/odometry", Odometry, self._on_wheels),
            ("visual_odometry/status", VisualOdometryStatus, self._on_status),
            ("visual_odometry/keyframes", Keyframes, self._on_keyframes),
        ):
            rospy.Subscriber(topic, kind, callback, queue_size=QUEUE_SIZE, tcp_nodelay=True)

    def spin(self) -> None:
        """Work until the node is shut down."""
        rospy.spin()
        self._keeper.end()

    def _forget(self) -> None:
        """Begin a run."""
        self._state: Optional[FusedState] = None
        self._keeper.clear()
        self._clock.reset()
        self._order.reset()
        self._turns.forget()
        self._visual.reset()
        self._latched: Optional[Keyframes] = None  # heard before the first window that came with a status
        self._window: Optional[OdometryStatus] = None  # the newest
        self._wheel_frame, self._wheel_pose = "", np.zeros(3)
        self._newest_status: Optional[OdometryStatus] = None
        self._publisher.reset()
        self._map.clear()

    # Input

    def _on_wheels(self, message: Odometry) -> None:
        start_s = time.perf_counter()
        with self._lock:
            self._wheels.heard()
            stamp_ns = message.header.stamp.to_nsec()
            try:
                pose = planar_pose(message.pose.pose)
            except ValueError as error:
                self._wheels.complain(str(error))
                return
            if stamp_ns == 0:
                self._wheels.complain("a message without a stamp")
                return
            kind = self._clock.follow(stamp_ns, self._start_anew)
            if kind is StampKind.DOUBTED:
                self._wheels.complain(f"the stamp {format_stamp(stamp_ns)} is {kind.value}")
                return
            self._order.heard_wheels(stamp_ns)
            self._use_latched_window()
            self._use_mount()
            doubt = "" if self._wheel_frame else other_body(message.child_frame_id, self._base_frame)
            if doubt:
                rospy.logwarn(one_line(f"{rospy.resolve_name('wheel/odometry')}: {doubt}"))
            self._wheel_frame, self._wheel_pose = message.header.frame_id.lstrip("/"), pose
            state = self._estimator.add_wheel_odometry(self._clock.inner_ns(stamp_ns), pose)
            if self._estimator.wheels.message:
                self._wheels.complain(self._estimator.wheels.message)
            self._publish(state, start_s)
            self._predict()

    def _on_status(self, message: VisualOdometryStatus) -> None:
        start_s = time.perf_counter()
        with self._lock:
            self._images.heard()
            self._order.heard_image(message.header.stamp.to_nsec())
            self._mount.name_frame(message.camera_frame_id)
            self._publisher.visual_frame = message.header.frame_id
            try:
                status = self._visual.status(message)
            except ValueError as error:
                self._images.complain(str(error))
                return
            if status is None:
                return
            on_wheel_clock_ns = status.stamp_ns + self._camera_offset_ns
            if self._order.is_usable(on_wheel_clock_ns, self._clock.last_ns, self._images.complain):
                self._take_in(status, message.header.stamp, start_s)
            elif self._order.disagrees:
                rospy.logwarn_throttle(10.0, one_line(self._order.apart))
                self._visual.distrust(message)
                self._check_clocks(status)

    def _check_clocks(self, status: OdometryStatus) -> None:
        """Use the images again, if camera and wheels turn at the same stamps: their clocks agree."""
        if not self._camera_known:
            return
        self._turns.add(status, self._estimator.robot.T_base_camera, self._camera_offset_ns)
        if self._turns.agrees(self._estimator.wheel_track, self._order.ahead_ns):
            rospy.logwarn("camera and wheels turn at the same stamps, so no clock was set: images are used again")
            self._order.agree()
            self._turns.forget()

    def _on_keyframes(self, message: Keyframes) -> None:
        """Keep the latched window, because while the robot stands still no new one may come for a long time."""
        with self._lock:
            self._latched = message
            self._use_latched_window()

    def _use_latched_window(self) -> None:
        """Use the latched window once the wheels tell the time: one from the future is of another run."""
        message, now_ns = self._latched, self._clock.last_ns
        if message is None or now_ns is None:
            return
        self._latched = None
        if self._window is not None:  # all further ones come with their statuses
            return
        try:
            window = self._visual.window(message)
        except ValueError as error:
            self._images.complain(str(error))
            return
        latest_ns = now_ns + CAMERA_AHEAD_NS - self._camera_offset_ns
        if any(keyframe.stamp_ns > latest_ns for keyframe in window.keyframes):
            return
        self._window = window
        if self._camera_known:
            self._estimator.add_keyframes(window)

    def _take_in(self, status: OdometryStatus, stamp: rospy.Time, start_s: float) -> None:
        if status.keyframes:
            self._window = status
        if not self._camera_known:  # its motion cannot be used without its mounting
            return
        self._newest_status = status
        for state in (self._estimator.add_keyframes(status), self._estimator.add_frame(status)):
            self._publish(state, start_s)
        if status.keyframes:
            self._map.add_window(stamp, status.keyframes, self._camera_offset_ns, self._estimator.robot.T_base_camera)

    def _use_mount(self) -> None:
        """Use the camera as soon as its mounting is known."""
        T_base_camera = None if self._camera_known else self._mount.find()
        if T_base_camera is None:
            return
        try:
            self._estimator.mount_camera(T_base_camera)
        except ConfigError as error:
            self._mount.complaint = f"by tf, {error}"
            return
        self._camera_known = True
        if self._window is not None:
            self._estimator.add_keyframes(self._window)

    # Output

    def _publish(self, state: Optional[FusedState], start_s: float) -> None:
        if state is None or rospy.is_shutdown():
            return
        self._state = state
        self._map.add_pose(state)
        if self._keeper.spool is not None:
            self._keeper.spool.add(state, self._estimator.wheels.total.pose)
            self._keeper.spool.add_motions(self._estimator.take_settled())
        self._counts.wheel_samples, self._counts.wheel_rejected = self._wheels.received, self._wheels.rejected
        self._counts.images = self._images.received
        self._counts.processing_ms = 1e3 * (time.perf_counter() - start_s)
        stamp = ros_time(self._clock.stamp_ns(state.stamp_ns))
        with publishing():
            self._publisher.publish(stamp, state, self._counts)
            self._transform.send(stamp, state.pose, self._wheel_frame, self._wheel_pose)
            for left in left_messages(self._estimator, self._clock):
                self._publisher.publish_left(left)

    def _predict(self) -> None:
        newest, now_ns = self._newest_status, self._clock.last_ns
        if newest is None or now_ns is None or not self._publisher.prediction_wanted:
            return
        end_ns = now_ns - self._camera_offset_ns
        motion = self._estimator.predict_camera_motion(newest, end_ns)
        span_ns = self._clock.stamp_ns(newest.predict_from_ns), self._clock.stamp_ns(end_ns)
        with publishing():
            self._publisher.publish_prediction(motion, *span_ns, newest.segment)

    def _reconfigure_output(self, settings: FusionOutputConfig, _level: int) -> FusionOutputConfig:
        output = OutputConfig(**{field.name: settings[field.name] for field in fields(OutputConfig)})
        with self._lock:
            self._config = replace(self._config, output=output)
            self._estimator.configure_output(output)
        return settings

    # Services

    def _start_anew(self) -> None:
        self._counts.resets += 1
        self._estimator.reset()
        self._forget()

    def _reset(self) -> str:
        with self._lock:
            window = self._window
            rospy.logwarn("asked to reset: restarting")
            self._start_anew()
            if window is not None and self._camera_known:
                self._window = window
                self._estimator.add_keyframes(window)
        return "the next wheel sample is the origin"

    def _set_pose(self, request: SetPoseRequest) -> SetPoseResponse:
        frame_id = request.pose.header.frame_id.lstrip("/")
        if frame_id and frame_id != self._odom_frame:
            return SetPoseResponse(False, one_line(f"the pose is in {frame_id[:100]}, not in {self._odom_frame}"))
        try:
            pose = planar_pose(request.pose.pose)
            if np.abs(pose[:2]).max() > LARGEST_SET_M:
                raise ValueError(f"the pose has a number beyond {LARGEST_SET_M:g}, from where no robot drives on")
        except ValueError as error:
            return SetPoseResponse(False, str(error))
        with self._lock:
            self._estimator.set_pose(pose)
        return SetPoseResponse(True, "")

    def _begin_spool(self, folder: SpoolFolder, limit: int) -> FusionSpool:
        return FusionSpool(folder, limit, self._config)

    def _newest_results(self, spool: FusionSpool) -> Dict[str, bytes]:
        with self._lock:
            return spool.newest(self._estimator.unsettled(), self._estimator.origin)

    # Diagnostics

    def _report(self, status: DiagnosticStatusWrapper) -> DiagnosticStatusWrapper:
        complaints = (
            (diagnostics.WARN, "" if self._camera_known else f"the camera is not used: {self._mount.complaint}"),
            (diagnostics.ERROR, self._transform.complaint),
            (diagnostics.WARN, self._keeper.complaint),
            (diagnostics.WARN, self._order.apart),
        )
        fusion_report.summarize(status, self._state, complaints)
        self._wheels.judge(status, rospy.resolve_name("wheel/odometry"))
        self._images.judge(status, rospy.resolve_name("visual_odometry/status"), diagnostics.WARN)
        fusion_report.add_figures(status, self._state, self._estimator.slips, self._counts, self._keeper.lost)
        return status
