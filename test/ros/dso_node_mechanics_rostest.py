#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""What dso_node does with images, good and bad, whatever they show."""

import subprocess
import sys
import time
import unittest

import numpy as np
import rospy
import rostest
from dso_node_player import Player, image_message
from sensor_msgs.msg import RegionOfInterest
from waiting import wait_until

from ceiling_dso_ros.msg import VisualOdometryStatus

WIDTH, HEIGHT = 848, 480
CAMERA = (WIDTH, HEIGHT, 425.0, 425.0, 424.0, 240.0)
FRAME_NS = 33_000_000
START_NS = 1_700_000_000 * 10**9
PIXELS = np.random.default_rng(0).integers(0, 255, (HEIGHT, WIDTH), dtype=np.uint8)


class DsoNodeMechanics(unittest.TestCase):
    """The tests share one node and go on in time; the first one (by name) meets it without a calibration."""

    @classmethod
    def setUpClass(cls):
        cls.player = Player()
        cls.now_ns = START_NS

    def next_image(self, pixels=PIXELS):
        type(self).now_ns += FRAME_NS
        return image_message(pixels, self.now_ns)

    def assert_skipped(self, image, complaint):
        """The image is counted as unusable, and the next good one is taken as if nothing had happened."""
        rejected = self.player.statuses[-1].rejected
        status = self.player.play(image)
        self.assertEqual(status.rejected, rejected + 1)
        self.assertIn(complaint, status.message)
        self.assertEqual((status.state, list(status.pose)), (VisualOdometryStatus.INITIALIZING, []))
        status = self.player.play(self.next_image())
        self.assertEqual(status.rejected, rejected + 1)
        self.assertEqual(status.state, VisualOdometryStatus.INITIALIZING)

    def test_0_waits_for_a_calibration(self):
        status = self.player.play(self.next_image())
        self.assertEqual(status.state, VisualOdometryStatus.WAITING)
        self.assertIn("/mechanics/camera/up/camera_info", status.message)
        self.player.calibrate(*CAMERA[:2], float("nan"), *CAMERA[3:])
        self.assertEqual(self.player.play(self.next_image()).state, VisualOdometryStatus.WAITING)
        self.player.calibrate(*CAMERA)
        wait_until(
            lambda: self.player.play(self.next_image()).state == VisualOdometryStatus.INITIALIZING,
            "the calibration is not taken up",
        )

    def test_wrong_parameters_are_refused_in_one_line(self):
        for number, (parameter, complaint) in enumerate(
            [
                ("_calibration:=/nowhere/camera.txt", "/nowhere/camera.txt"),
                ("_image_transport:=pigeon", "image_transport=pigeon: raw or compressed"),
                ("_bit_depth:=17", "bit_depth 17: 8 to 16, or 0 to find it from the images"),
            ]
        ):
            # Parameters outlast a node.
            command = ["rosrun", "ceiling_dso_ros", "dso_node", f"__name:=refused_{number}", parameter]
            node = subprocess.run(command, capture_output=True, text=True, timeout=60)
            self.assertEqual(node.returncode, 2)
            self.assertIn(complaint, node.stderr)
            self.assertEqual(len(node.stderr.strip().splitlines()), 1)

    def test_status_is_that_of_the_image(self):
        image = self.next_image()
        status = self.player.play(image)
        self.assertEqual(status.header.stamp, image.header.stamp)
        self.assertEqual(status.header.frame_id, "vo")
        self.assertEqual(status.segment, 0)
        self.assertGreater(status.processing_ms, 0.0)

    def test_unknown_encoding(self):
        image = self.next_image()
        image.encoding = "bayer_unheard_of"
        self.assert_skipped(image, "bayer_unheard_of")

    def test_truncated_image(self):
        image = self.next_image()
        image.data = image.data[:1000]
        self.assert_skipped(image, "1000")

    def test_empty_image(self):
        image = self.next_image()
        image.data, image.width, image.height, image.step = b"", 0, 0, 0
        self.assert_skipped(image, "0")

    def test_image_of_another_size(self):
        self.assert_skipped(self.next_image(PIXELS[:240, :424].copy()), "424x240")

    def play_until(self, state, pixels, text=""):
        """Play images of the same kind until one has that state; camera_info comes over another connection."""
        status = None

        def is_reached():
            nonlocal status
            status = self.player.play(self.next_image(pixels))
            return status.state == state and text in status.message

        wait_until(is_reached, lambda: f"{status.state}: {status.message}")

    def test_sizes_and_cameras_may_change_and_may_be_any(self):
        """423x239 is cropped, 120x100 is too small, and the sensor of 848x480 is also given with binning."""
        try:
            for size, state, text in (
                ((423, 239), VisualOdometryStatus.INITIALIZING, "first frame of a segment"),
                ((120, 100), VisualOdometryStatus.WAITING, "images of 120x100 pixels: too small to be tracked"),
            ):
                self.player.calibrate(*size, 425.0, 425.0, size[0] / 2, size[1] / 2)
                self.play_until(state, PIXELS[: size[1], : size[0]].copy(), text)
            roi = RegionOfInterest(x_offset=100, y_offset=50, width=2 * WIDTH, height=2 * HEIGHT)
            self.player.calibrate(2000, 1200, 850.0, 850.0, 948.5, 530.5, binning_x=2, binning_y=2, roi=roi)
            self.play_until(VisualOdometryStatus.INITIALIZING, PIXELS, "first frame of a segment")
        finally:
            self.player.calibrate(*CAMERA)
            self.play_until(VisualOdometryStatus.INITIALIZING, PIXELS)

    def test_camera_info_for_images_of_another_size_changes_nothing(self):
        rejected = self.player.play(self.next_image()).rejected
        try:
            self.player.calibrate(640, 480, 425.0, 425.0, 320.0, 240.0)
            until = time.monotonic() + 1.0  # it comes over another connection
            while time.monotonic() < until:
                status = self.player.play(self.next_image())
                self.assertEqual((status.state, status.rejected), (VisualOdometryStatus.INITIALIZING, rejected))
                self.assertNotIn("first frame", status.message)
        finally:
            self.player.calibrate(*CAMERA)

    def test_encodings(self):
        for encoding, pixels in (
            ("bayer_rggb8", PIXELS),
            ("mono16", PIXELS.astype(np.uint16) << 4),
            ("8UC3", np.dstack([PIXELS] * 3)),
            ("32FC1", PIXELS.astype(np.float32)),
        ):
            self.next_image()
            rejected = self.player.statuses[-1].rejected
            status = self.player.play(image_message(pixels, self.now_ns, encoding))
            self.assertEqual((status.rejected, status.state), (rejected, VisualOdometryStatus.INITIALIZING), encoding)

    def test_no_stamp(self):
        image = self.next_image()
        image.header.stamp = rospy.Time()
        self.assert_skipped(image, "no stamp")

    def test_repeated_stamp(self):
        image = self.next_image()
        self.player.play(image)
        self.assert_skipped(image, "stamp")

    def test_images_that_come_at_once_are_worked_off_in_their_order_and_drops_are_counted(self):
        before, noise = self.player.statuses[-1], np.random.default_rng(0)
        count = len(self.player.statuses)
        # None shows a motion, of which the odometry would make a map; repeated ones would take no time.
        burst = [self.next_image(PIXELS ^ noise.integers(0, 2, PIXELS.shape, np.uint8)) for _ in range(60)]
        for image in burst:
            self.player.send(image)
        wait_until(
            lambda: self.player.statuses[-1].header.stamp == burst[-1].header.stamp, "the newest image is not processed"
        )
        after, processed = self.player.statuses[-1], self.player.statuses[count:]
        self.assertEqual(after.images, before.images + len(burst))
        self.assertEqual(len(processed) + after.dropped - before.dropped, len(burst))
        stamps = [status.header.stamp for status in processed]
        self.assertEqual(stamps, sorted(stamps))

    def test_an_image_that_is_out_of_order_is_dropped_and_nothing_is_forgotten(self):
        self.player.play(self.next_image())
        late = image_message(PIXELS, self.now_ns - 1_000_000)
        message = self.player.play(late).message
        self.assertIn("before that of the last one", message)
        self.assertNotEqual(self.player.play(self.next_image()).message, "first frame of a segment")

    def test_a_clock_that_is_set_back_is_followed(self):
        """Only in the time of a bag would that be another run."""
        self.player.play(self.next_image())
        rejected = self.player.statuses[-1].rejected
        type(self).now_ns -= 2 * 10**9
        for _ in range(2):
            image = self.next_image()
            status = self.player.play(image)
            self.assertEqual(status.header.stamp, image.header.stamp)
            self.assertNotEqual(status.message, "first frame of a segment")
        self.assertEqual(status.rejected, rejected)


if __name__ == "__main__":
    rospy.init_node("dso_node_mechanics")
    rostest.rosrun("ceiling_dso_ros", "dso_node_mechanics", DsoNodeMechanics, sys.argv)
