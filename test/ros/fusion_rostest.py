#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""wheel_odometry_node and fusion_node on a robot that drives: what a navigation stack takes from them."""

import sys
import time

import numpy as np
import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticStatus
from driving_robot import DrivingRobot
from fake_robot import (
    CAMERA_HZ,
    FRAMES_PER_KEYFRAME,
    LASER_XYZ,
    SCALE_M,
    SPEED_M_S,
    TURN_RAD_S,
    parents,
    xy_yaw,
)
from geometry_msgs.msg import Pose, PoseArray
from message_filters import Subscriber, TimeSynchronizer
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage
from waiting import SOON_S, wait_until

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.msg import FusionScale, FusionStatus, MotionPrediction, RelativePose, VisualOdometryStatus
from ceiling_dso_ros.ros.conversions import matrix_from_pose, matrix_from_transform

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


class Fusion(DrivingRobot):
    """The tests share the nodes; the robot drives on through all of them."""

    def test_0_scale_is_found(self):
        self.assertEqual(self.listener.statuses[0].state, FusionStatus.NOT_SCALED)
        scale = self.listener.scales[-1]
        self.assertAlmostEqual(scale.scale, SCALE_M, delta=0.02 * SCALE_M)
        self.assertTrue(0.0 < scale.sigma < 0.02)
        self.assertEqual((scale.segment, scale.header.frame_id), (0, "vo"))
        self.assertEqual(self.listener.statuses[-1].state, FusionStatus.CONVERGED)
        self.assertEqual(list(self.listener.statuses[-1].reasons), [])

    def test_odometry_is_what_a_local_planner_takes(self):
        poses = self.recent(2.0)
        stamps = np.array([message.header.stamp.to_sec() for message in poses])
        self.assertGreater(np.diff(stamps).min(), 0.0)
        self.assertGreater(len(poses) / (stamps[-1] - stamps[0]), 20.0)
        for message in poses:
            self.assertEqual((message.header.frame_id, message.child_frame_id), ("odom", "base_link"))
            for covariance in (message.pose.covariance, message.twist.covariance):
                covariance = np.reshape(covariance, (6, 6))
                self.assertTrue(np.isfinite(covariance).all())
                self.assertGreater(np.linalg.eigvalsh(covariance).min(), 0.0)
            self.assertAlmostEqual(message.twist.twist.linear.x, SPEED_M_S, delta=0.05)
            self.assertAlmostEqual(message.twist.twist.angular.z, TURN_RAD_S, delta=0.05)
        steps = [planar.between(xy_yaw(a), xy_yaw(b)) for a, b in zip(poses, poses[1:])]
        self.assertLess(np.abs(steps).max(), 0.03)  # 10 mm and 5 mrad of motion, and no jump

    def test_the_output_does_not_fall_behind(self):
        """How late it is, is for the benchmarks; here no queue may fill."""
        first = len(self.listener.poses)
        self.listener.wait_for_poses(200)
        pairs = zip(self.listener.arrivals_s[first:], self.listener.poses[first:])
        delays_s = [arrival_s - message.header.stamp.to_sec() for arrival_s, message in pairs]
        self.assertLess(np.median(delays_s), 0.5)  # of the 2 s that the robot's queue holds

    def test_laser_points_stay_where_they_are(self):
        """The part of a costmap: a post, measured from wherever the laser is, stays on its place in odom."""
        T_base_laser = planar.lift(np.zeros(3))
        T_base_laser[:3, 3] = LASER_XYZ
        hits = []
        for _ in range(30):
            stamp = rospy.Time.now()
            found = self.listener.transform("odom", "laser", stamp)
            self.assertAlmostEqual((found.header.stamp - stamp).to_sec(), 0.0, delta=1e-6)
            T_world_laser = planar.lift(self.robot.pose(stamp.to_sec())) @ T_base_laser
            seen = np.linalg.inv(T_world_laser) @ [5.0, 3.0, 0.2, 1.0]
            hits.append(matrix_from_transform(found.transform) @ seen)
            time.sleep(0.05)
        self.assertLess(np.ptp(hits, axis=0).max(), 0.02)

    def test_tf_is_the_odometry_and_every_frame_has_one_parent(self):
        message = self.recent(0.2)[-1]
        found = self.listener.transform("odom", "base_link", message.header.stamp)
        self.assertAlmostEqual(found.transform.translation.x, message.pose.pose.position.x, places=9)
        self.assertAlmostEqual(found.transform.rotation.z, message.pose.pose.orientation.z, places=9)
        authorities = parents("base_link")
        self.assertEqual(authorities, {("odom", "/fusion_node")})

    def test_motion_prediction_is_the_motion_of_the_camera(self):
        message = rospy.wait_for_message("fusion/motion_prediction", MotionPrediction, 30.0)
        start, end = (self.robot.pose(stamp.to_sec()) for stamp in (message.start, message.header.stamp))
        expected = planar.lift(planar.between(start, end))
        expected[:3, 3] /= SCALE_M
        np.testing.assert_allclose(matrix_from_pose(message.motion), expected, atol=2e-3)
        self.assertGreater((message.header.stamp - message.start).to_sec(), 0.0)

    def test_map_is_metric_and_in_odom(self):
        cloud = rospy.wait_for_message("fusion/points", PointCloud2, 30.0)
        keyframes = rospy.wait_for_message("fusion/keyframes", PoseArray, 30.0)
        self.assertEqual((cloud.header.frame_id, keyframes.header.frame_id), ("odom", "odom"))
        lamp = np.frombuffer(cloud.data, np.float32)[:3]
        self.listener.wait_for_poses(5)
        stamps = [abs((message.header.stamp - cloud.header.stamp).to_sec()) for message in self.listener.poses]
        robot = xy_yaw(self.listener.poses[int(np.argmin(stamps))])
        np.testing.assert_allclose(lamp, [robot[0], robot[1], SCALE_M], atol=0.05)
        steps = np.diff([[pose.position.x, pose.position.y] for pose in keyframes.poses], axis=0)
        expected = SPEED_M_S * FRAMES_PER_KEYFRAME / CAMERA_HZ
        np.testing.assert_allclose(np.linalg.norm(steps, axis=1), expected, rtol=0.05)

    def test_camera_silent_for_three_seconds(self):
        before = self.recent(0.1)[-1]
        self.robot.camera = False
        try:
            self.assertLess(self.listener.wait_for_level("fusion_node", WARN), SOON_S)
            self.assertIn("visual_odometry/status silent", self.listener.diagnostics["fusion_node"].message)
            blind = self.recent(3.0)
        finally:
            self.robot.camera = True
        self.assertEqual(self.listener.statuses[-1].state, FusionStatus.DEGRADED)
        self.assertTrue(any("camera" in reason for reason in self.listener.statuses[-1].reasons))
        variances = [np.reshape(message.pose.covariance, (6, 6))[5, 5] for message in (before, blind[-1])]
        self.assertGreater(variances[1], variances[0])
        self.listener.wait_for_level("fusion_node", OK)

    def test_wheels_silent_for_two_seconds(self):
        """The camera carries on alone, and the wheels are taken in again."""
        count = len(self.listener.poses)
        self.robot.wheels = False
        try:
            self.assertLess(self.listener.wait_for_level("wheel_odometry_node", ERROR), SOON_S)
            self.listener.wait_for_level("fusion_node", ERROR)
            time.sleep(1.0)
        finally:
            self.robot.wheels = True
        self.assertGreater(len(self.listener.poses), count + 10)
        self.listener.wait_for_level("wheel_odometry_node", OK)
        self.listener.wait_for_level("fusion_node", OK)

    def test_garbage_on_the_wheels(self):
        for angles, names in (
            ((float("nan"), 0.0), ("left_wheel", "right_wheel")),
            ((0.0, float("inf")), ("left_wheel", "right_wheel")),
        ):
            self.robot.joint_state(*angles, names)
            self.listener.wait_for_level("wheel_odometry_node", WARN)
            self.assertIn("not finite", self.listener.diagnostics["wheel_odometry_node"].message)
            self.listener.wait_for_level("wheel_odometry_node", OK)
        for names in (("elbow", "wrist"), ("left_wheel",), ()):
            self.robot.joint_state(1.0, 2.0, names)
        self.assertTrue(np.isfinite([xy_yaw(message) for message in self.recent(0.5)]).all())

    def test_joint_states_without_wheels(self):
        self.robot.wheels = False
        try:
            self.listener.wait_for_level("wheel_odometry_node", ERROR)
            self.robot.joint_state(1.0, 2.0, ("elbow", "wrist"))
            wait_until(lambda: "left_joint" in self.listener.diagnostics["wheel_odometry_node"].message, "no hint")
        finally:
            self.robot.wheels = True

    def test_garbage_in_the_odometry(self):
        publisher = rospy.Publisher("wheel/odometry", Odometry, queue_size=10)
        wait_until(lambda: publisher.get_num_connections() >= 2, "nobody listens")
        message = Odometry(header=Header(stamp=rospy.Time.now(), frame_id="odom"))
        publisher.publish(message)  # a quaternion of zeros
        self.listener.wait_for_level("fusion_node", WARN)
        self.assertIn("quaternion", self.listener.diagnostics["fusion_node"].message)
        message.pose.pose.orientation.w = float("nan")
        publisher.publish(message)
        wait_until(lambda: "not finite" in self.listener.diagnostics["fusion_node"].message, "no complaint")
        message.pose.pose.orientation.w, message.header.stamp = 1.0, rospy.Time()
        publisher.publish(message)
        wait_until(lambda: "without a stamp" in self.listener.diagnostics["fusion_node"].message, "no complaint")
        self.listener.wait_for_level("fusion_node", OK)
        self.assertEqual(self.listener.statuses[-1].resets, self.listener.statuses[-100].resets)
        publisher.unregister()

    def test_garbage_in_the_visual_odometry(self):
        publisher = rospy.Publisher("visual_odometry/status", VisualOdometryStatus, queue_size=10)
        wait_until(lambda: publisher.get_num_connections() >= 1, "nobody listens")
        pose = RelativePose(keyframe_id=10**6, pose=Pose())
        status = VisualOdometryStatus(header=Header(stamp=rospy.Time.now(), frame_id="vo"), state=2, pose=[pose])
        publisher.publish(status)  # a pose of zeros
        self.listener.wait_for_level("fusion_node", WARN)
        self.assertIn("quaternion", self.listener.diagnostics["fusion_node"].message)
        pose.pose.orientation.w = 1.0
        publisher.publish(status)  # relative to a keyframe that does not exist
        pose.pose.orientation.w = float("nan")
        publisher.publish(status)
        status.pose = [pose, pose]
        publisher.publish(status)
        status.pose = []  # of an image that the odometry did not use
        publisher.publish(status)
        status.state = 77
        publisher.publish(status)
        self.assertTrue(np.isfinite([xy_yaw(message) for message in self.recent(0.5)]).all())
        publisher.unregister()

    def test_a_clock_that_is_set_back_does_not_move_the_pose(self):
        """Nor does one that is set forward again: this robot does not live in the time of a bag."""
        resets = self.listener.statuses[-1].resets
        for shift_ns in (-1_000_000_000, -100_000_000_000, 100_000_000_000, 1_000_000_000):
            first, before = len(self.listener.poses) - 1, self.robot.now_s()
            self.robot.shift_ns += shift_ns
            self.listener.wait_for_poses(75)
            poses = self.listener.poses[first:]
            steps = [planar.between(xy_yaw(a), xy_yaw(b)) for a, b in zip(poses, poses[1:])]
            self.assertLess(np.abs(steps).max(), 0.1)
            elapsed_s = np.diff([message.header.stamp.to_sec() for message in poses])
            self.assertAlmostEqual(elapsed_s[np.argmax(np.abs(elapsed_s))], shift_ns * 1e-9, delta=0.5)
            self.assertAlmostEqual(poses[-1].header.stamp.to_sec(), before + shift_ns * 1e-9, delta=5.0)
            self.listener.wait_for_level("fusion_node", OK)
        self.assertEqual(self.listener.statuses[-1].resets, resets)
        self.listener.wait_for_scale(self.robot)

    def test_outputs_carry_the_very_stamp_of_the_wheel_sample(self):
        """ExactTime puts all of a sample together, and tf has a transform of that very time."""
        topics = {
            "joint_states": JointState,
            "wheel/odometry": Odometry,
            "odometry/filtered": Odometry,
            "fusion/status": FusionStatus,
            "fusion/scale": FusionScale,
        }
        inputs = [Subscriber(topic, kind, queue_size=500) for topic, kind in topics.items()]
        together, samples = [], []
        inputs[0].registerCallback(samples.append)
        TimeSynchronizer(inputs, 500).registerCallback(lambda *messages: together.append(messages))
        sent = {}  # by tf; what a Python buffer gives back has been through a float
        subscriber = rospy.Subscriber(
            "/tf",
            TFMessage,
            lambda message: sent.update((t.header.stamp, t) for t in message.transforms),
            queue_size=500,
        )
        wait_until(lambda: len(together) >= 150, "nothing fits together")
        stamps = [messages[0].header.stamp.to_nsec() for messages in together]
        expected = [message.header.stamp.to_nsec() for message in samples]
        first = expected.index(stamps[0])
        self.assertEqual(stamps[:150], expected[first : first + 150])
        self.assertTrue(any(stamp_ns % 1000 for stamp_ns in stamps))
        last = together[-20:]
        # Each topic comes by a connection of its own: tf's message may come after the odometry's.
        wait_until(
            lambda: all(messages[2].header.stamp in sent for messages in last), "tf lacks stamps of the odometry"
        )
        for messages in last:
            stamp, x = messages[2].header.stamp, messages[2].pose.pose.position.x
            self.assertEqual(sent[stamp].transform.translation.x, x)
            found = self.listener.transform("odom", "base_link", stamp)
            self.assertAlmostEqual(found.transform.translation.x, x, places=6)
        subscriber.unregister()


if __name__ == "__main__":
    rospy.init_node("fusion_rostest")
    rostest.rosrun("ceiling_dso_ros", "fusion", Fusion, sys.argv)
