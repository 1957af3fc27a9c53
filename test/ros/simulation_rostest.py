#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""simulation_node as a live source for everything that runs on a robot."""

import sys
import time
import unittest

import rospy
import rostest
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image

DURATION_S = 4.0  # as in simulation.test
TIMEOUT_S = 120.0


class Simulation(unittest.TestCase):
    def test_robot_drives_and_its_pose_comes_out(self):
        clocks, images, poses = [], [], []
        rospy.Subscriber("/clock", Clock, lambda message: clocks.append(message.clock.to_sec()), queue_size=1000)
        rospy.Subscriber(
            "camera/up/image_raw", Image, lambda m: images.append((m.width, m.height)), queue_size=100, buff_size=2**24
        )
        rospy.Subscriber("odometry/filtered", Odometry, poses.append, queue_size=1000)
        deadline = time.monotonic() + TIMEOUT_S
        while not clocks or clocks[-1] < clocks[0] + 0.8 * DURATION_S:
            self.assertLess(time.monotonic(), deadline, "the clock stands still")
            time.sleep(0.1)
        self.assertEqual(clocks, sorted(clocks))
        self.assertGreater(len(images), 10)
        self.assertEqual(set(images), {(848, 480)})
        self.assertGreater(len(poses), 20)
        self.assertAlmostEqual(poses[-1].header.stamp.to_sec(), clocks[-1], delta=1.0)
        self.assertGreater(poses[-1].pose.pose.position.x, 0.5)


if __name__ == "__main__":
    rospy.init_node("simulation_rostest")
    rostest.rosrun("ceiling_dso_ros", "simulation", Simulation, sys.argv)
