#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""fusion_node beside a wheel driver that publishes the transform of the base itself."""

import sys
import unittest

import numpy as np
import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticStatus
from fake_robot import FakeRobot, Listener, parents, xy_yaw
from geometry_msgs.msg import PoseStamped
from std_msgs.msg import Header

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.ros.conversions import matrix_from_transform, pose_from_matrix
from ceiling_dso_ros.srv import SetPose


class TfCorrection(unittest.TestCase):
    def test_every_frame_has_one_parent_and_the_chain_is_the_fused_pose(self):
        listener = Listener()
        with FakeRobot() as robot:
            listener.wait_for_level("fusion_node", DiagnosticStatus.OK)
            listener.wait_for_scale(robot)
            # Far from the wheels' own idea, so that the correction has something to correct.
            there = PoseStamped(Header(), pose_from_matrix(planar.lift(np.array([3.0, -2.0, 1.0]))))
            self.assertTrue(rospy.ServiceProxy("fusion_node/set_pose", SetPose)(there).success)
            listener.wait_for_poses(20)
            self.assertEqual(parents("base_link"), {("odom", "/wheel_driver")})
            self.assertEqual(parents("odom"), {("odom_fused", "/fusion_node")})
            message = listener.poses[-1]
            found = listener.transform("odom_fused", "base_link", message.header.stamp)
            expected = planar.lift(xy_yaw(message))
            np.testing.assert_allclose(matrix_from_transform(found.transform), expected, atol=1e-6)
            self.assertEqual(message.header.frame_id, "odom_fused")


if __name__ == "__main__":
    rospy.init_node("tf_correction_rostest")
    rostest.rosrun("ceiling_dso_ros", "tf_correction", TfCorrection, sys.argv)
