#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""A path follower drives the simulated robot by odometry/filtered and cmd_vel alone, with slips and a covered lens."""

import math
import sys
import unittest
from functools import partial

import numpy as np
import rospy
import rostest
import tf2_ros
from fake_robot import planar_pose, xy_yaw
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import OccupancyGrid, Odometry
from path_follower import PathFollower, distance_m, path
from sensor_msgs.msg import LaserScan
from std_msgs.msg import String
from waiting import wait_until

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.msg import FusionStatus, VisualOdometryStatus

TO_THE_START = path((2.5, 0))
PATH = path((2.6, 0), (1.9, 90), (1.4, 0), (1.9, 90), (2.0, 0), (1.9, -90), (1.4, 0))
EVENTS = {4.8: "slip+0.4", 7.0: "cover+2.0", 10.3: "slip+0.4"}  # where along the path
WITHIN_M = 0.02
COMMAND_TIMEOUT_S, BRAKING_M_S2 = 0.5, 0.8  # of the simulated base


def moved(one, two):
    """Motion (3,) between two geometry_msgs/PoseStamped."""
    return planar.between(planar_pose(one.pose), planar_pose(two.pose))


class ClosedLoop(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.truth, cls.wheels, cls.visual, cls.fusion, cls.scans = [], [], [], [], []
        cls.fused, cls.follower = None, None
        cls.commands = rospy.Publisher("cmd_vel", Twist, queue_size=1, tcp_nodelay=True)
        cls.events = rospy.Publisher("simulation_node/event", String, queue_size=10)
        for name, kind, messages in (
            ("ground_truth", PoseStamped, cls.truth),
            ("odom", Odometry, cls.wheels),
            ("visual_odometry/status", VisualOdometryStatus, cls.visual),
            ("fusion/status", FusionStatus, cls.fusion),
            ("scan", LaserScan, cls.scans),
        ):
            rospy.Subscriber(name, kind, messages.append, queue_size=1000)
        rospy.Subscriber("odometry/filtered", Odometry, cls.on_odometry, queue_size=10, tcp_nodelay=True)
        wait_until(lambda: cls.fused is not None and len(cls.visual) > 3, "nothing on odometry/filtered")

    @classmethod
    def on_odometry(cls, message):
        cls.fused = message
        if cls.follower is not None:
            cls.send(*cls.follower.command(xy_yaw(message)))

    @classmethod
    def send(cls, speed, yaw_rate=0.0):
        command = Twist()
        command.linear.x, command.angular.z = speed, yaw_rate
        cls.commands.publish(command)

    @classmethod
    def follow(cls, points, events):
        """Follow a path from here, with events at places along it; returns when the robot stands at its end."""
        cls.follower = follower = PathFollower(points, xy_yaw(cls.fused))
        for place_m, event in events.items():
            wait_until(partial(follower.has_passed, place_m), f"it does not come to {place_m} m")
            cls.events.publish(event)
        wait_until(lambda: follower.left_m < 0.01, lambda: f"{follower.left_m:.2f} m are left")
        wait_until(lambda: cls.true_speed() == 0.0, "it does not stop")

    @classmethod
    def true_speed(cls, steps=10):
        """Over the last wheel readings, m/s to a tenth of a millimetre."""
        one, two = cls.truth[-1 - steps], cls.truth[-1]
        time_s = (two.header.stamp - one.header.stamp).to_sec()
        return round(float(np.linalg.norm(moved(one, two)[:2])) / time_s, 4)

    def test_1_the_path_is_followed(self):
        self.follow(TO_THE_START, {})  # until the scale is known, the fused pose is that of the wheels
        wait_until(lambda: self.fusion[-1].state == FusionStatus.CONVERGED, "the scale does not become known")
        rospy.sleep(1.0)  # corrections come smoothly
        start, wheels, fused = self.truth[-1], self.wheels[-1], self.fused
        first, first_scan, dropped = len(self.truth), len(self.scans), self.visual[-1].dropped
        self.follow(PATH, EVENTS)
        ends = {
            "true": moved(start, self.truth[-1])[:2],
            "fused": planar.between(xy_yaw(fused), xy_yaw(self.fused))[:2],
            "wheels": planar.between(xy_yaw(wheels), xy_yaw(self.wheels[-1]))[:2],
        }
        off_m = [distance_m(PATH, moved(start, pose)[:2]) for pose in self.truth[first:]]
        wrong_m = {name: np.linalg.norm(end - ends["true"]) for name, end in ends.items()}
        print(f"off the path: {off_m[-1]:.4f} m at the end, {max(off_m):.4f} m on the way; wrong by "
              f"{wrong_m['fused']:.4f} m: odometry/filtered, {wrong_m['wheels']:.3f} m: the wheels")  # fmt: skip
        self.assertLess(off_m[-1], WITHIN_M)
        self.assertLess(np.linalg.norm(ends["true"] - PATH[-1]), 0.1)
        self.assertGreater(wrong_m["wheels"], 0.5, "by its wheels alone it would have got lost")
        self.assertEqual(self.visual[-1].dropped, dropped, "time waits for the odometry")
        self.assertGreater(len(self.scans), first_scan + 100)

    def test_2_it_stops_when_commands_stop(self):
        self.__class__.follower = None
        speed = -0.4  # back along the path

        def drives():
            self.send(speed)
            self.send(math.nan)  # is not used
            rospy.sleep(0.1)
            return abs(self.true_speed() - abs(speed)) < 0.05

        wait_until(drives, "it does not drive")
        before = self.truth[-1]
        wait_until(lambda: self.true_speed() == 0.0, "it does not stop")
        way_m = np.linalg.norm(moved(before, self.truth[-1])[:2])
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
        hall = rospy.wait_for_message("map", OccupancyGrid, 10.0)
        self.assertEqual(set(hall.data), {0, 100})


if __name__ == "__main__":
    rospy.init_node("closed_loop_rostest")
    rostest.rosrun("ceiling_dso_ros", "closed_loop", ClosedLoop, sys.argv)
