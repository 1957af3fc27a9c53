#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""dso_node on a camera that never stops: services, diagnostics, the map, and whatever can go wrong."""

import os
import signal
import subprocess
import sys
import tempfile
import time
import unittest
from pathlib import Path

import numpy as np
import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticStatus
from dynamic_reconfigure.client import Client
from fake_camera import CAMERA, FakeCamera
from fake_robot import Listener, end_node
from geometry_msgs.msg import PoseStamped
from message_filters import Subscriber, TimeSynchronizer
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from sensor_msgs.msg import Image, PointCloud2
from std_srvs.srv import Trigger
from waiting import SOON_S, wait_until

from ceiling_dso_ros.io.trajectory import read_tum
from ceiling_dso_ros.msg import Keyframes, VisualOdometryStatus
from ceiling_dso_ros.srv import SaveTrajectory

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


def trigger(name):
    rospy.wait_for_service(f"dso_node/{name}", 30.0)
    return rospy.ServiceProxy(f"dso_node/{name}", Trigger)().success


def save(directory):
    rospy.wait_for_service("dso_node/save_trajectory", 30.0)
    return rospy.ServiceProxy("dso_node/save_trajectory", SaveTrajectory)(str(directory))


def next_message(topic, kind):
    return rospy.wait_for_message(topic, kind, 30.0)


class DsoNodeLive(unittest.TestCase):
    """The tests share the node; the camera goes on through all of them."""

    @classmethod
    def setUpClass(cls):
        cls.listener = Listener()
        cls.statuses = []
        rospy.Subscriber("visual_odometry/status", VisualOdometryStatus, cls.statuses.append, queue_size=100)
        cls.camera = FakeCamera().__enter__()

    @classmethod
    def tearDownClass(cls):
        cls.camera.__exit__()

    def setUp(self):
        wait_until(lambda: self.statuses and self.statuses[-1].state == VisualOdometryStatus.TRACKING, "no tracking")
        self.listener.wait_for_level("dso_node", OK)

    @property
    def text(self):
        return self.listener.diagnostics["dso_node"].message

    def test_diagnostics_say_how_it_goes(self):
        values = {value.key: value.value for value in self.listener.diagnostics["dso_node"].values}
        self.assertIn("tracking", self.text)
        self.assertGreater(float(values["/camera/up/image_raw: rate [Hz]"]), 3.0)
        self.assertGreater(int(values["active points"]), 0)

    def test_points_and_debug_image_come_when_somebody_looks(self):
        cloud = next_message("visual_odometry/points", PointCloud2)
        while cloud.width <= 50:  # while there is no map they are empty
            cloud = next_message("visual_odometry/points", PointCloud2)
        self.assertEqual([field.name for field in cloud.fields], ["x", "y", "z", "intensity"])
        points = np.frombuffer(cloud.data, np.float32).reshape(-1, 4)
        self.assertEqual((len(points), cloud.header.frame_id), (cloud.width, "vo"))
        self.assertTrue(np.isfinite(points).all())
        image = next_message("visual_odometry/debug_image", Image)
        self.assertEqual((image.width, image.height, image.encoding), (CAMERA.width, CAMERA.height, "bgr8"))
        colours = np.frombuffer(image.data, np.uint8).reshape(image.height, image.width, 3)
        self.assertGreater((colours.max(axis=2) != colours.min(axis=2)).sum(), 500)
        self.assertGreater(len(next_message("visual_odometry/path", PathMessage).poses), 0)

    def test_pause_and_resume(self):
        self.assertTrue(trigger("pause"))
        self.listener.wait_for_level("dso_node", WARN)
        self.assertEqual(self.text, "paused")
        time.sleep(0.5)
        count = len(self.statuses)
        time.sleep(0.5)
        self.assertEqual(len(self.statuses), count)
        self.assertTrue(trigger("resume"))
        wait_until(lambda: len(self.statuses) > count, "no images after resume")

    def test_reset(self):
        first = len(self.statuses)
        self.assertTrue(trigger("reset"))
        wait_until(
            lambda: any(s.state == VisualOdometryStatus.INITIALIZING and s.segment == 0 for s in self.statuses[first:]),
            "it does not begin anew",
        )

    def test_save_trajectory(self):
        with tempfile.TemporaryDirectory() as folder:
            answer = save(Path(folder) / "new")
            self.assertTrue(answer.success, answer.message)
            for name in ("camera", "camera_final", "keyframes"):
                self.assertGreater(len(read_tum(Path(folder) / "new" / f"{name}.tum")), 0)
        answer = save("/proc/nowhere")
        self.assertFalse(answer.success)
        self.assertIn("/proc/nowhere", answer.message)

    def test_camera_silent(self):
        self.camera.images = False
        try:
            self.assertLess(self.listener.wait_for_level("dso_node", ERROR), SOON_S)
            self.assertIn("silent", self.text)
        finally:
            self.camera.images = True
        self.listener.wait_for_level("dso_node", OK)

    def test_garbage(self):
        for complaint, change in (
            ("encoding", {"encoding": "bayer_unheard_of"}),
            ("bytes", {"data": b"\0" * 1000}),
            ("0x0", {"data": b"", "width": 0, "height": 0, "step": 0}),
            ("100x100", {"data": b"\0" * 10000, "width": 100, "height": 100, "step": 100}),
        ):
            image = self.camera.image()
            for name, value in change.items():
                setattr(image, name, value)
            for _ in range(3):  # one alone may be replaced by a newer image
                self.camera.send(image)
                time.sleep(0.1)
            wait_until(lambda c=complaint: c in self.text, lambda c=complaint: f"{c} not in: {self.text}")
            self.assertEqual(self.listener.level("dso_node"), WARN)
        self.listener.wait_for_level("dso_node", OK)

    def test_camera_info_that_is_wrong_is_ignored_and_that_changes_is_taken(self):
        self.camera.focal_px = float("nan")
        self.listener.wait_for_level("dso_node", WARN)
        self.assertIn("not finite", self.text)
        first = len(self.statuses)
        self.camera.focal_px = CAMERA.fx + 1.0
        wait_until(
            lambda: any(s.state == VisualOdometryStatus.INITIALIZING for s in self.statuses[first:]), "not taken up"
        )
        self.listener.wait_for_level("dso_node", OK)

    def test_covered_lens(self):
        first = len(self.statuses)
        self.camera.pixels = np.zeros((CAMERA.height, CAMERA.width), np.uint8)
        try:
            wait_until(lambda: self.listener.level("dso_node") in (WARN, ERROR), "nobody notices")
            wait_until(
                lambda: any(s.state == VisualOdometryStatus.RECOVERING and s.segment for s in self.statuses[first:]),
                "it does not recover in a new segment",
            )
        finally:
            self.camera.pixels = None
        self.listener.wait_for_level("dso_node", OK)

    def test_a_clock_that_is_set_back_loses_nothing(self):
        first, lost = len(self.statuses) - 1, [VisualOdometryStatus.LOST, VisualOdometryStatus.INITIALIZING]
        segment = self.statuses[-1].segment
        self.camera.shift_ns -= 100 * 10**9
        wait_until(lambda: len(self.statuses) >= first + 31, "no images")
        after = self.statuses[first:]
        steps_s = np.diff([status.header.stamp.to_sec() for status in after])
        self.assertLess(steps_s.min(), -90.0)  # the stamps are those of the images
        self.assertFalse([status.message for status in after if status.state in lost])
        self.assertEqual({status.segment for status in after}, {segment})
        self.listener.wait_for_level("dso_node", OK)

    def test_all_that_is_said_of_an_image_has_its_very_stamp(self):
        """ExactTime puts it together."""
        of_image = {"camera/up/image_raw": Image, "visual_odometry/status": VisualOdometryStatus}
        of_pose = {"visual_odometry/odometry": Odometry, "visual_odometry/pose": PoseStamped}
        first = len(self.statuses)
        poses, windows = [], []
        for others, together in ((of_pose, poses), ({"visual_odometry/keyframes": Keyframes}, windows)):
            inputs = [Subscriber(topic, kind, queue_size=100) for topic, kind in {**of_image, **others}.items()]
            TimeSynchronizer(inputs, 100).registerCallback(lambda *messages, t=together: t.append(messages))
        wait_until(lambda: len(poses) >= 30 and len(windows) >= 3, lambda: f"{len(poses)} and {len(windows)} fit")
        wait_until(lambda: self.statuses[-1].header.stamp > poses[29][0].header.stamp, "no status")
        statuses = [status for status in self.statuses[first:] if status.pose]
        stamps = [status.header.stamp for status in statuses]
        begin = stamps.index(poses[0][0].header.stamp)
        self.assertEqual([messages[0].header.stamp for messages in poses[:30]], stamps[begin : begin + 30])
        for _, status, window in windows:
            self.assertEqual(list(status.keyframes), list(window.keyframes))

    def test_the_newest_window_is_latched(self):
        self.camera.images = False
        try:
            time.sleep(0.5)
            newest = [status.keyframes for status in self.statuses if status.keyframes][-1]
            self.assertEqual(list(next_message("visual_odometry/keyframes", Keyframes).keyframes), list(newest))
        finally:
            self.camera.images = True

    def test_interrupt_ends_the_node_in_time_and_writes_the_trajectories(self):
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder) / "out"
            command = ["rosrun", "ceiling_dso_ros", "dso_node", "__name:=short_lived", f"_trajectory_dir:={out}"]
            remaps = ["image:=camera/up/image_raw", "camera_info:=camera/up/camera_info"]
            topics = [f"visual_odometry/{name}:=short/{name}" for name in ("status", "odometry", "keyframes", "pose")]
            node = subprocess.Popen([*command, *remaps, *topics], start_new_session=True)
            next_message("short/odometry", rospy.AnyMsg)
            os.killpg(node.pid, signal.SIGINT)
            self.assertEqual(node.wait(15.0), 0)  # roslaunch kills a node that takes longer
            self.assertGreater(len(read_tum(out / "camera.tum")), 0)

    def test_frame_rate_while_driving(self):
        client = Client("dso_node")
        try:
            client.update_configuration({"frame_rate": 5.0})
            self.assertEqual(rospy.get_param("dso_node/frame_rate"), "5.0")
            time.sleep(0.5)  # what was under way
            first = len(self.statuses)
            wait_until(lambda: len(self.statuses) >= first + 5, "no images any more")
        finally:
            client.update_configuration({"frame_rate": 0.0})
        stamps_s = [status.header.stamp.to_sec() for status in self.statuses[first:]]
        self.assertGreater(np.diff(stamps_s).min(), 0.12)  # the camera's images are 0.067 s apart

    def test_image_size(self):
        for size, state, text in (
            ("240x180", VisualOdometryStatus.INITIALIZING, ""),
            ("318x238", VisualOdometryStatus.WAITING, "318x238 pixels: too small to be tracked, or not divisible by 4"),
            ("640x480", VisualOdometryStatus.WAITING, "640x480 is larger than the images, 320x240"),
        ):
            command = ["rosrun", "ceiling_dso_ros", "dso_node", "__name:=scaled", f"_image_size:={size}"]
            remaps = ["image:=camera/up/image_raw", "camera_info:=camera/up/camera_info"]
            names = ("status", "odometry", "keyframes", "pose", "debug_image")
            topics = [f"visual_odometry/{name}:=scaled/{name}" for name in names]
            node = subprocess.Popen([*command, *remaps, *topics], start_new_session=True)
            try:
                status = next_message("scaled/status", VisualOdometryStatus)
                self.assertEqual(status.state, state)
                self.assertIn(text, status.message)
                if not text:
                    image = next_message("scaled/debug_image", Image)
                    self.assertEqual((image.width, image.height), (240, 180))
            finally:
                os.killpg(node.pid, signal.SIGINT)
                self.assertEqual(node.wait(30.0), 0)

    def test_wrong_output_folder_is_refused(self):
        node = subprocess.run(
            ["rosrun", "ceiling_dso_ros", "dso_node", "__name:=refused", "_trajectory_dir:=/proc/nowhere"],
            capture_output=True,
            text=True,
            timeout=60,
        )
        self.assertEqual(node.returncode, 2)
        self.assertIn("/proc/nowhere", node.stderr)

    def test_z_restart(self):
        end_node("/dso_node")
        del self.listener.diagnostics["dso_node"]
        self.listener.wait_for_level("dso_node", OK)


if __name__ == "__main__":
    rospy.init_node("dso_node_live_rostest")
    rostest.rosrun("ceiling_dso_ros", "dso_node_live", DsoNodeLive, sys.argv)
