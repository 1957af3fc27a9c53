#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""dso_node on images of a ceiling: its poses are those of the odometry itself."""

import os
import sys
import unittest
from pathlib import Path

import cv2
import numpy as np
import rospy
import rostest
from dso_node_player import Player, compressed_message
from dynamic_reconfigure.client import Client
from sensor_msgs.msg import CompressedImage
from std_srvs.srv import Trigger
from waiting import wait_until

from ceiling_dso_ros.dso import DirectOdometry, PinholeCamera, TrackingState
from ceiling_dso_ros.io.image_decoding import decode_compressed
from ceiling_dso_ros.io.stamps import parse_stamp_ns
from ceiling_dso_ros.msg import VisualOdometryStatus
from ceiling_dso_ros.ros.conversions import pose_from_matrix
from ceiling_dso_ros.ros.odometry_publisher import PATH_SPACING

CHECKOUT = Path(__file__).resolve().parents[2]
FOLDER = Path(os.environ.get("CEILING_DSO_DATA", CHECKOUT.parent / "shared" / "data")) / "ceiling_loops"
CAMERA = PinholeCamera(425.31, 424.87, 427.6, 236.4, 848, 480)
FRAMES = 90  # a map is there after about half of them


def read_frames():
    """(bytes of the JPEG, stamp_ns, exposure_ms) of the first images."""
    for line in (FOLDER / "times.txt").read_text().splitlines()[:FRAMES]:
        name, stamp, exposure_ms = line.split()
        yield (FOLDER / "images" / f"{name}.jpg").read_bytes(), parse_stamp_ns(stamp), float(exposure_ms)


def components(pose):
    """Position and quaternion of a geometry_msgs/Pose, (7,)."""
    p, q = pose.position, pose.orientation
    return np.array([p.x, p.y, p.z, q.x, q.y, q.z, q.w])


@unittest.skipUnless(FOLDER.is_dir(), f"no recording in {FOLDER}")
class DsoNodeCeiling(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        """Play the recording, each image when the one before is done."""
        cls.frames = list(read_frames())
        cls.player = Player("camera/up/image_raw/compressed", CompressedImage)
        cls.player.calibrate(CAMERA.width, CAMERA.height, CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy)
        wait_until(lambda: cls.play(0).state != VisualOdometryStatus.WAITING, "the calibration is not taken up")
        cls.statuses = [cls.player.statuses[-1], *(cls.play(index) for index in range(1, FRAMES))]
        cls.tracked = [status for status in cls.statuses if status.state == VisualOdometryStatus.TRACKING]
        # Each topic comes by a connection of its own: what belongs to the last status may come after it.
        wait_until(lambda: len(cls.player.odometry) == len(cls.tracked), "there are statuses without odometry")
        windows = sum(bool(status.keyframes) for status in cls.statuses)
        wait_until(lambda: len(cls.player.keyframes) == windows, "there are statuses without their keyframes")

    @classmethod
    def play(cls, index):
        jpeg, stamp_ns, exposure_ms = cls.frames[index]
        return cls.player.play(compressed_message(jpeg, stamp_ns), exposure_ms)

    def test_every_pose_is_that_of_the_odometry(self):
        odometry = DirectOdometry(CAMERA)
        statuses = [
            odometry.track(decode_compressed(jpeg).astype(np.float32), stamp_ns, exposure_ms)
            for jpeg, stamp_ns, exposure_ms in self.frames
        ]
        expected = [status for status in statuses if status.state is TrackingState.TRACKING]
        self.assertGreater(len(expected), FRAMES // 4)
        self.assertEqual(
            [message.header.stamp.to_nsec() for message in self.player.odometry],
            [stamp_ns for (_, stamp_ns, _), status in zip(self.frames, statuses) if status in expected],
        )
        for message, status in zip(self.player.odometry, expected):
            np.testing.assert_allclose(
                components(message.pose.pose), components(pose_from_matrix(status.T_world_camera)), atol=1e-9
            )

    def test_odometry_says_what_it_knows(self):
        self.assertTrue(self.player.odometry)
        for message in self.player.odometry:
            self.assertEqual((message.header.frame_id, message.child_frame_id), ("vo", "camera"))
            covariance = np.reshape(message.pose.covariance, (6, 6))
            self.assertGreater(np.linalg.eigvalsh(covariance).min(), 0.0)
            self.assertGreater(np.reshape(message.twist.covariance, (6, 6)).diagonal().min(), 1000.0)

    def test_statuses_count_what_they_should(self):
        self.assertEqual([status.header.stamp.to_nsec() for status in self.statuses], [row[1] for row in self.frames])
        self.assertEqual(self.statuses[-1].state, VisualOdometryStatus.TRACKING)
        self.assertEqual((self.statuses[-1].dropped, self.statuses[-1].rejected), (0, 0))
        for status in self.tracked:
            self.assertGreater(status.active_points, 0)
            self.assertTrue(0.0 < status.rmse < 50.0)

    def test_keyframes_are_published_when_the_window_changes(self):
        newest = [message.keyframes[-1].id for message in self.player.keyframes]
        self.assertGreater(len(newest), 1)
        self.assertEqual(newest, sorted(newest))
        with_window = {status.header.stamp: list(status.keyframes) for status in self.statuses if status.keyframes}
        self.assertEqual(
            {message.header.stamp: list(message.keyframes) for message in self.player.keyframes}, with_window
        )

    def test_keyframes_carry_the_very_stamps_of_their_images(self):
        stamps_ns = {keyframe.stamp.to_nsec() for message in self.player.keyframes for keyframe in message.keyframes}
        self.assertLessEqual(stamps_ns, {stamp_ns for _, stamp_ns, _ in self.frames})
        self.assertTrue(all(len(status.pose) == (status in self.tracked) for status in self.statuses))

    def test_path_is_that_of_the_poses_thinned(self):
        path = self.player.paths[-1]
        self.assertEqual(path.header.frame_id, "vo")
        self.assertGreater(len(path.poses), 10)
        known = {message.header.stamp: message.pose.pose for message in self.player.odometry}
        self.assertEqual([pose.pose for pose in path.poses], [known[pose.header.stamp] for pose in path.poses])
        places = np.array([components(pose.pose)[:3] for pose in path.poses])
        self.assertGreaterEqual(np.linalg.norm(np.diff(places, axis=0), axis=1)[:-1].min(), PATH_SPACING)

    def test_z_plays_the_recording_again(self):
        """After a reset it gives the same again; settings change while the node runs."""
        rospy.wait_for_service("dso_node/reset", 30.0)
        self.assertTrue(rospy.ServiceProxy("dso_node/reset", Trigger)().success)
        Client("dso_node").update_configuration({"path_length": 10, "path_period": 0.0})
        again = [self.play(index) for index in range(FRAMES)]
        self.assertEqual([status.state for status in again], [status.state for status in self.statuses])
        self.assertEqual({status.segment for status in again}, {0})
        wait_until(lambda: self.player.paths[-1].header.stamp == again[-1].header.stamp, "the path is not up to date")
        self.assertEqual(len(self.player.paths[-1].poses), 10)

    def test_zz_covered_lens(self):
        """Odometry goes on with the last pose and says that nothing is known of it any more."""
        last = self.player.odometry[-1]
        black = cv2.imencode(".jpg", np.zeros((CAMERA.height, CAMERA.width), np.uint8))[1].tobytes()
        stamps_ns = [self.frames[-1][1] + 200_000_000 * number for number in range(1, 11)]
        states = [self.player.play(compressed_message(black, stamp_ns), 1.0).state for stamp_ns in stamps_ns]
        self.assertIn(VisualOdometryStatus.LOST, states)
        self.assertNotEqual(states[-1], VisualOdometryStatus.TRACKING)
        wait_until(lambda: self.player.odometry[-1].header.stamp.to_nsec() == stamps_ns[-1], "odometry stops")
        blind = self.player.odometry[-1]
        self.assertEqual(np.reshape(blind.pose.covariance, (6, 6)).diagonal().tolist(), [9999.0] * 6)
        np.testing.assert_allclose(components(blind.pose.pose), components(last.pose.pose), atol=1.0)


if __name__ == "__main__":
    rospy.init_node("dso_node_ceiling")
    rostest.rosrun("ceiling_dso_ros", "dso_node_ceiling", DsoNodeCeiling, sys.argv)
