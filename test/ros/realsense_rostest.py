#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""realsense_node with cameras that are plugged in and out; one test after the other, in the order of their names."""

import os
import shutil
import signal
import time
import unittest
import xmlrpc.client
from pathlib import Path

import numpy as np
import rosgraph
import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray
from dynamic_reconfigure.client import Client
from fake_bench import FakeBench, exposure_ms_of, truth_of
from sensor_msgs.msg import CameraInfo, Image, Imu
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage

from ceiling_dso_ros.msg import Exposure

PATIENCE_S = 60.0
NODE = "/realsense_node"
OK, ERROR = 0, 2
KEPT = 1000


def wait_until(condition, complaint="it takes too long"):
    """Wait; returns how long it took."""
    start_s = time.monotonic()
    while not condition():
        if time.monotonic() > start_s + PATIENCE_S:
            raise AssertionError(complaint() if callable(complaint) else complaint)
        time.sleep(0.01)
    return time.monotonic() - start_s


class Listener:
    """Hears all that the node publishes."""

    def __init__(self):
        self.images, self.right, self.exposures, self.infos, self.imu = [], [], [], [], []
        self.level, self.message, self.transforms = None, "", {}
        for topic, kind, kept in (
            ("camera/up/image_raw", Image, self.images),
            ("camera/up_right/image_raw", Image, self.right),
            ("camera/up/exposure", Exposure, self.exposures),
            ("camera/up/camera_info", CameraInfo, self.infos),
            ("camera/imu", Imu, self.imu),
        ):
            rospy.Subscriber(topic, kind, lambda message, kept=kept: self._keep(message, kept), buff_size=2**24)
        rospy.Subscriber("/diagnostics", DiagnosticArray, self._on_diagnostics)
        rospy.Subscriber("/tf_static", TFMessage, self._on_tf)

    @staticmethod
    def _keep(message, kept):
        kept.append((time.monotonic(), message))
        del kept[:-KEPT]

    def _on_diagnostics(self, message):
        for status in message.status:
            if status.name.startswith("realsense_node"):
                self.level, self.message = status.level, status.message

    def _on_tf(self, message):
        self.transforms.update({each.child_frame_id: each for each in message.transforms})

    def wait_for_images(self, count=1):
        """Wait for some more; returns when the first of them came."""
        start_s = time.monotonic()
        wait_until(lambda: len(self.images) >= count and self.images[-count][0] > start_s, lambda: self.message)
        return next(came_s for came_s, _ in self.images if came_s > start_s)

    def wait_for_message(self, text):
        """Wait for the diagnostics; returns how long it took."""
        return wait_until(lambda: text in self.message, lambda: f"the diagnostics say: {self.message}")


def pixels(image):
    return np.frombuffer(image.data, np.uint8).reshape(image.height, image.width)


def children(pid):
    return [
        int(child) for task in Path(f"/proc/{pid}/task").iterdir() for child in (task / "children").read_text().split()
    ]


def rosnode_names():
    return {name for names in rosgraph.Master("/test").getSystemState() for _, nodes in names for name in nodes}


def node_pid():
    uri = rosgraph.Master("/test").lookupNode(NODE)
    return xmlrpc.client.ServerProxy(uri).getPid("/test")[2]


class RealsenseTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("realsense_test")
        cls.bench = FakeBench(Path(os.environ["FAKE_REALSENSE"]))
        cls.heard = Listener()
        wait_until(lambda: NODE in rosnode_names(), "the node does not begin")
        cls.pid = node_pid()

    @classmethod
    def tearDownClass(cls):
        shutil.rmtree(cls.bench.folder, ignore_errors=True)

    def test_1_without_a_camera_it_says_so_and_lives(self):
        self.heard.wait_for_message("no RealSense camera is connected")
        self.assertEqual(self.heard.level, ERROR)

    def test_2_images_with_exposures_and_the_time_of_day(self):
        self.bench.plug_in(jitter_ms=5.0, drift_ppm=50.0)
        self.heard.wait_for_images(90)
        wait_until(lambda: self.heard.level == OK and len(self.heard.right) > 10 and len(self.heard.imu) > 100)
        images = [image for _, image in self.heard.images]
        exposures = {message.header.stamp.to_nsec(): message.exposure_ms for _, message in self.heard.exposures}
        truths = [truth_of(pixels(image)) for image in images]
        numbers = [number for number, _, _ in truths]
        self.assertEqual(numbers, sorted(set(numbers)))
        stamps_ns = [image.header.stamp.to_nsec() for image in images]
        self.assertEqual(stamps_ns, sorted(set(stamps_ns)))
        known = [(exposures[stamp_ns], number) for stamp_ns, number in zip(stamps_ns, numbers) if stamp_ns in exposures]
        self.assertGreater(len(known), 60)
        for exposure_ms, number in known:
            self.assertAlmostEqual(exposure_ms, exposure_ms_of(number), places=6)
        errors_ms = [1e-6 * (stamp_ns - truth[1]) for stamp_ns, truth in zip(stamps_ns, truths)]
        self.assertLess(np.abs(errors_ms[-30:]).max(), 1.0)
        _, info = self.heard.infos[-1]
        self.assertEqual((info.width, info.height, info.header.frame_id), (424, 240, "camera_up_optical_frame"))
        self.assertEqual({truth_of(pixels(image))[2] for _, image in self.heard.right}, {2})
        wait_until(lambda: len(self.heard.transforms) == 2)
        self.assertAlmostEqual(self.heard.transforms["camera_up_right_optical_frame"].transform.translation.x, 0.095)

    def test_3_unplugged_for_ten_seconds(self):
        self.bench.unplug()
        self.assertLess(self.heard.wait_for_message("no RealSense camera is connected"), 2.0)
        self.assertEqual(self.heard.level, ERROR)
        time.sleep(10.0)
        self.bench.plug_in(port="1-1", starting_s=0.5)
        back_s = time.monotonic()
        self.assertLess(self.heard.wait_for_images() - back_s, 3.0)

    def test_4_the_streaming_process_is_killed(self):
        for _ in range(3):
            wait_until(lambda: children(self.pid))
            os.kill(children(self.pid)[0], signal.SIGKILL)
            self.heard.wait_for_images(10)
        self.assertEqual(node_pid(), self.pid)

    def test_5_exposure_may_be_changed(self):
        client = Client(NODE, timeout=PATIENCE_S)
        client.update_configuration({"fixed_exposure_ms": 3.0, "fixed_gain": 32})
        wait_until(lambda: (self.bench.options().get("exposure"), self.bench.options().get("gain")) == (3000, 32))
        with self.assertRaises(Exception):  # noqa: B017 dynamic_reconfigure raises several
            client.update_configuration({"fixed_exposure_ms": 0.001})
        self.assertEqual(self.bench.options()["exposure"], 3000)

    def test_6_the_camera_is_reset(self):
        self.heard.wait_for_images()
        answer = rospy.ServiceProxy(f"{NODE}/reset_device", Trigger)()
        self.assertEqual(answer.message, "the camera is reset")
        wait_until((self.bench.folder / "reset").exists)
        self.heard.wait_for_images(10)

    def test_7_by_usb_2_and_without_metadata(self):
        self.bench.unplug()
        self.bench.plug_in(usb="2.1", metadata=False)
        self.heard.wait_for_message("connected by USB 2.1")
        self.heard.wait_for_message("no metadata")
        self.heard.wait_for_images(10)
        wait_until(lambda: self.heard.exposures[-1][1].exposure_ms == 0.0)


if __name__ == "__main__":
    rostest.rosrun("ceiling_dso_ros", "realsense", RealsenseTest)
