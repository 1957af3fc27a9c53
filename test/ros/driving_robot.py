# SPDX-License-Identifier: BSD-3-Clause
"""What the rostests of the fusion have in common: a robot that drives on through all tests of a file."""

import unittest

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from fake_robot import (
    FakeRobot,
    Listener,
    xy_yaw,
)
from waiting import wait_until

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


def service(name, kind):
    rospy.wait_for_service(name, 30.0)
    return rospy.ServiceProxy(name, kind)


class DrivingRobot(unittest.TestCase):
    """The tests share the nodes; the robot drives on through all of them."""

    @classmethod
    def setUpClass(cls):
        cls.listener = Listener()
        cls.robot = FakeRobot().__enter__()
        cls.listener.wait_for_poses(1)

    @classmethod
    def tearDownClass(cls):
        cls.robot.__exit__()

    def setUp(self):
        self.listener.diagnostics.clear()  # what the test before has caused
        self.listener.wait_for_level("wheel_odometry_node", OK)
        self.listener.wait_for_level("fusion_node", OK)
        self.listener.wait_for_scale(self.robot)

    def recent(self, seconds):
        """The poses of the next seconds."""
        first = len(self.listener.poses)
        self.listener.wait_for_poses(int(50 * seconds))
        return self.listener.poses[first:]

    def drive_away(self, messages):
        """Wait until nav_msgs/Odometry are so far from their origin that the robot cannot be there soon."""
        wait_until(lambda: np.linalg.norm(xy_yaw(messages[-1])[:2]) > 3.0, "the robot stays near its origin")
