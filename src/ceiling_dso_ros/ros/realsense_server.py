# SPDX-License-Identifier: BSD-3-Clause
"""The server behind realsense_node: a RealSense in, images with stamps and exposure times out."""

import math
import time
import traceback
from typing import Tuple

import rospy
from diagnostic_updater import DiagnosticStatusWrapper

from ceiling_dso_ros.cfg import RealsenseConfig
from ceiling_dso_ros.drivers.camera_feed import CameraFeed
from ceiling_dso_ros.drivers.camera_process import CameraProcess
from ceiling_dso_ros.drivers.image_times import StampSource
from ceiling_dso_ros.drivers.reports import Connected, Remark, Report, Waiting
from ceiling_dso_ros.io.errors import InputError, one_line
from ceiling_dso_ros.ros import diagnostics, parameters
from ceiling_dso_ros.ros.node import publishing
from ceiling_dso_ros.ros.node_parameters import RealsenseParameters, camera_settings, exposure_settings
from ceiling_dso_ros.ros.reconfigure import ReconfigureServer
from ceiling_dso_ros.ros.services import offer_trigger
from ceiling_dso_ros.ros.topic_writer import TopicWriter

WARNING_PERIOD_S = 10.0
NOTHING_SAID = ("", -math.inf)  # why there are no images, and when it was logged


class RealsenseServer:
    """Streams a RealSense D455 that looks up. It survives whatever happens to the camera, and says what that is.

    Publishes:
        camera/up/image_raw (sensor_msgs/Image): mono8, rectified, stamped in the middle of the exposure.
        camera/up/camera_info (sensor_msgs/CameraInfo)
        camera/up/exposure (ceiling_dso_ros/Exposure): exposure time of each image, 0 if the camera does not say it.
        camera/up_right/image_raw, camera/up_right/camera_info, camera/up_right/exposure: with ~stereo.
        camera/imu (sensor_msgs/Imu): with ~imu, in the camera's own axes, without an orientation.
        /tf_static: ~camera_frame -> the right camera and the inertial unit.
        /diagnostics

    Services:
        ~reset_device (std_srvs/Trigger): restart the camera, as if it was unplugged; takes up to half a minute.

    Parameters (private, read at start): `RealsenseParameters`; cfg/Realsense.cfg has those that may change while
        running.
    """

    def __init__(self) -> None:
        """Read the parameters and look for the camera.

        Raises:
            InputError: a parameter is wrong.
        """
        (own,) = parameters.read(RealsenseParameters)
        self._settings = camera_settings(own)
        self._exposure = self._settings.exposure
        self._images = diagnostics.Stream(own.silence)
        self._feed = CameraFeed(TopicWriter(), own.camera_frame.lstrip("/"))
        self._said = NOTHING_SAID
        self._complaints: Tuple[str, ...] = ()
        self._process = CameraProcess(self._settings, self._take_safely)
        self._reconfigure_server = ReconfigureServer(RealsenseConfig, self._reconfigure)
        offer_trigger("~reset_device", self._reset_device)
        diagnostics.Diagnostics(self._report, "realsense")

    def spin(self) -> None:
        """Work until the node is shut down."""
        rospy.on_shutdown(self._process.close)
        self._process.start()
        rospy.spin()

    # Input

    def _take_safely(self, report: Report) -> None:
        """An error with one report must not end the thread that hears them."""
        try:
            with publishing():
                self._take(report)
        except Exception:
            rospy.logerr_throttle(WARNING_PERIOD_S, f"a report of the camera was not used: {traceback.format_exc()}")

    def _take(self, report: Report) -> None:
        source = self._feed.stamper.source
        if self._feed.take(report) is not None:
            self._images.heard()
        if self._feed.stamper.source is not None and self._feed.stamper.source is not source:
            rospy.loginfo("images are stamped with %s", self._feed.stamper.source.value)
        if isinstance(report, Connected):
            rospy.loginfo("streaming %s", report.camera)
            self._said = NOTHING_SAID
            for complaint in report.camera.complaints:
                if complaint not in self._complaints:  # it is said once, however often the camera comes back
                    rospy.logwarn(one_line(complaint))
            self._complaints = report.camera.complaints
        elif isinstance(report, Waiting):
            self._say(report.message)
        elif isinstance(report, Remark):
            rospy.logwarn(one_line(report.message))

    def _say(self, message: str) -> None:
        """Log why there are no images, when it changes, and again and again."""
        text, last_s = self._said
        now_s = time.monotonic()
        if message != text or now_s - last_s >= WARNING_PERIOD_S:
            rospy.logwarn(one_line(message))
            self._said = (message, now_s)

    # Requests

    def _reset_device(self) -> str:
        return "the camera is reset" if self._process.reset_device() else "there is no camera to reset"

    def _reconfigure(self, settings: RealsenseConfig, _level: int) -> RealsenseConfig:
        exposure = exposure_settings(settings)
        try:
            exposure.check()
        except InputError as error:
            rospy.logwarn("%s; nothing is changed", error)
            raise rospy.ServiceException(str(error)) from error
        if exposure != self._exposure:
            self._exposure = exposure
            self._process.expose(exposure)
        return settings

    # Diagnostics

    def _report(self, status: DiagnosticStatusWrapper) -> DiagnosticStatusWrapper:
        feed, stamper, camera = self._feed, self._feed.stamper, self._feed.camera
        if feed.waiting or camera is None:
            status.summary(diagnostics.ERROR, feed.waiting)
        else:
            status.summary(diagnostics.OK, f"streaming {camera.mode}")
            for complaint in camera.complaints:
                status.mergeSummary(diagnostics.WARN, complaint)
            if stamper.source is not None and stamper.source is not StampSource.MIDDLE:
                status.mergeSummary(diagnostics.WARN, f"images are stamped with {stamper.source.value}")
        self._images.judge(status, rospy.resolve_name("camera/up/image_raw"))
        if camera is not None:
            parts = ("name", "serial_no", "firmware", "usb", "port", "mode")
            for part in parts:
                status.add(part.replace("_", " "), str(getattr(camera, part)))
        newest = feed.newest
        exposure_ms = None if newest is None else newest.exposure_ms
        status.add("exposure [ms]", "unknown" if exposure_ms is None else f"{exposure_ms:.2f}")
        status.add("gain", "unknown" if feed.gain is None else str(feed.gain))
        status.add("dropped", str(stamper.dropped))
        status.add("without a usable stamp", str(stamper.refused))
        status.add("drift of the camera's clock [ppm]", f"{1e6 * stamper.clock.drift:.1f}")
        status.add("starts of the streaming process", str(self._process.starts))
        return status
