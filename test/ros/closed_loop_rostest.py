#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""A path follower drives the simulated robot by odometry/filtered and cmd_vel alone, with slips and a covered lens."""

import math
import sys
import unittest

import numpy as np
import rospy
import rostest
import tf2_ros
from fake_robot import planar_pose, xy_yaw
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import Odometry
from path_follower import PathFollower, distance_m, path
from sensor_msgs.msg import LaserScan
from std_msgs.msg import String
from waiting import wait_until

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.msg import VisualOdometryStatus

PATH = path((2.6, 0), (1.9, 90), (1.4, 0), (1.9, 90), (2.0, 0), (1.9, -90), (1.4, 0))
EVENTS = {5.2: "slip+0.4", 7.0: "cover+2.0", 10.3: "slip+0.4"}  # where along the path
WITHIN_M = 0.02
COMMAND_TIMEOUT_S, BRAKING_M_S2 = 0.5, 0.8  # of the simulated base


class ClosedLoop(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.truth, cls.statuses, cls.scans, cls.wheels = [], [], [], []
        cls.fused = None
        cls.follower = None
        cls.commands = rospy.Publisher("cmd_vel", Twist, queue_size=1, tcp_nodelay=True)
        cls.events = rospy.Publisher("simulation_node/event", String, queue_size=10)
        rospy.Subscriber("ground_truth", PoseStamped, cls.truth.append, queue_size=1000)
        rospy.Subscriber("odom", Odometry, cls.wheels.append, queue_size=1000)
        rospy.Subscriber("scan", LaserScan, cls.scans.append, queue_size=1000)
        rospy.Subscriber("visual_odometry/status", VisualOdometryStatus, cls.statuses.append, queue_size=1000)
        rospy.Subscriber("odometry/filtered", Odometry, cls.on_odometry, queue_size=10, tcp_nodelay=True)
        wait_until(lambda: cls.fused is not None and len(cls.statuses) > 3, "nothing on odometry/filtered")

    @classmethod
    def on_odometry(cls, message):
        cls.fused = message
        if cls.follower is not None:
            cls.send(*cls.follower.command(*xy_yaw(message)))

    @classmethod
    def send(cls, speed, yaw_rate=0.0):
        command = Twist()
        command.linear.x, command.angular.z = speed, yaw_rate
        cls.commands.publish(command)

    def in_odom(self, pose):
        """x, y, yaw from where the robot started, which is where odom begins."""
        return planar.between(self.start, planar_pose(pose.pose))

    def test_1_the_path_is_followed(self):
        self.__class__.start = planar_pose(self.truth[0].pose)
        self.start = self.__class__.start
        first_scan, dropped = len(self.scans), self.statuses[-1].dropped
        follower = self.__class__.follower = PathFollower(PATH)
        for place_m, event in EVENTS.items():
            wait_until(lambda place_m=place_m: follower.driven_m > place_m, f"it does not come to {place_m} m")
            self.events.publish(event)
        wait_until(lambda: follower.left_m < 0.01, lambda: f"{follower.left_m:.2f} m are left")
        wait_until(lambda: self.true_speed() == 0.0, "it does not stop")
        off = [distance_m(PATH, self.in_odom(pose)[:2]) for pose in self.truth]
        wheels_alone = np.linalg.norm(self.in_odom(self.truth[-1])[:2] - xy_yaw(self.wheels[-1])[:2])
        fused = np.linalg.norm(self.in_odom(self.truth[-1])[:2] - xy_yaw(self.fused)[:2])
        print(f"off the path: {off[-1]:.4f} m at the end, {max(off):.4f} m at most; wheels alone are wrong by "
              f"{wheels_alone:.3f} m, the fused pose by {fused:.4f} m")  # fmt: skip
        self.assertLess(off[-1], WITHIN_M)
        self.assertLess(np.linalg.norm(self.in_odom(self.truth[-1])[:2] - PATH[-1]), 0.1)
        self.assertGreater(wheels_alone, 0.2, "without the camera it would have got lost")
        self.assertEqual(self.statuses[-1].dropped, dropped, "time waits for the odometry")
        self.assertGreater(len(self.scans), first_scan + 100)

    def true_speed(self, steps=10):
        """Over the last wheel readings, m/s."""
        one, two = self.truth[-1 - steps], self.truth[-1]
        time_s = (two.header.stamp - one.header.stamp).to_sec()
        return round(
            float(np.linalg.norm(planar.between(planar_pose(one.pose), planar_pose(two.pose))[:2])) / time_s, 4
        )

    def test_2_it_stops_when_commands_stop(self):
        self.__class__.follower = None
        speed = -0.4  # back along the path
        until = rospy.Time.now() + rospy.Duration(1.5)
        while rospy.Time.now() < until:
            self.send(speed)
            self.send(math.nan)  # is not used
            rospy.sleep(0.1)
        self.assertAlmostEqual(self.true_speed(), abs(speed), delta=0.05)
        before = self.truth[-1]
        wait_until(lambda: self.true_speed() == 0.0, "it does not stop")
        way_m = np.linalg.norm(planar.between(planar_pose(before.pose), planar_pose(self.truth[-1].pose))[:2])
        expected_m = abs(speed) * COMMAND_TIMEOUT_S + speed**2 / (2 * BRAKING_M_S2)
        self.assertLess(way_m, expected_m + 0.05)
        self.assertGreater(way_m, 0.05)

    def test_3_frames_of_the_truth_are_apart_from_those_of_the_robot(self):
        transforms = tf2_ros.Buffer()
        tf2_ros.TransformListener(transforms)
        wait_until(lambda: transforms.can_transform("map", "ground_truth/base_link", rospy.Time(0)))
        wait_until(lambda: transforms.can_transform("map", "base_link", rospy.Time(0)))
        true, fused = (transforms.lookup_transform("map", frame, rospy.Time(0)).transform.translation
                       for frame in ("ground_truth/base_link", "base_link"))  # fmt: skip
        self.assertLess(math.hypot(true.x - fused.x, true.y - fused.y), 0.1)

    def test_4_the_scanner_sees_the_hall(self):
        ranges = np.array(self.scans[-1].ranges)
        self.assertEqual(len(ranges), 541)
        self.assertGreater(np.isfinite(ranges).mean(), 0.95)
        self.assertGreater(self.scans[-1].time_increment, 0.0)


if __name__ == "__main__":
    rospy.init_node("closed_loop_rostest")
    rostest.rosrun("ceiling_dso_ros", "closed_loop", ClosedLoop, sys.argv)
