#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""wheel_odometry_node and fusion_node on a robot that drives: what a navigation stack takes from them."""

import subprocess
import sys
import tempfile
import time
import unittest
from pathlib import Path

import numpy as np
import rospy
import rostest
import tf2_ros
from diagnostic_msgs.msg import DiagnosticStatus
from dynamic_reconfigure import DynamicReconfigureCallbackException
from dynamic_reconfigure.client import Client
from fake_robot import (
    CAMERA_HZ,
    FRAMES_PER_KEYFRAME,
    LASER_XYZ,
    SCALE_M,
    SPEED_M_S,
    TURN_RAD_S,
    FakeRobot,
    Listener,
    any_pose,
    end_node,
    parents,
    wait_until,
    xy_yaw,
)
from geometry_msgs.msg import Pose, PoseArray, PoseStamped, TransformStamped
from message_filters import Subscriber, TimeSynchronizer
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import Header
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.io.trajectory import read_tum
from ceiling_dso_ros.msg import FusionScale, FusionStatus, MotionPrediction, RelativePose, VisualOdometryStatus
from ceiling_dso_ros.ros.conversions import matrix_from_pose, matrix_from_transform
from ceiling_dso_ros.srv import SaveTrajectory, SetPose

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


def service(name, kind):
    rospy.wait_for_service(name, 30.0)
    return rospy.ServiceProxy(name, kind)


class Fusion(unittest.TestCase):
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

    def test_latency_is_bounded(self):
        first = len(self.listener.poses)
        self.listener.wait_for_poses(100)
        pairs = zip(self.listener.arrivals_s[first:], self.listener.poses[first:])
        delays = [arrival_s - message.header.stamp.to_sec() for arrival_s, message in pairs]
        self.assertLess(np.median(delays), 0.05)
        self.assertLess(max(delays), 0.5)

    def test_laser_points_stay_where_they_are(self):
        """The part of a costmap: a post, measured from wherever the laser is, stays on its place in odom."""
        T_base_laser = planar.lift(np.zeros(3))
        T_base_laser[:3, 3] = LASER_XYZ
        hits = []
        for _ in range(30):
            stamp = rospy.Time.now()
            found = self.listener.buffer.lookup_transform("odom", "laser", stamp, rospy.Duration(1.0))
            self.assertAlmostEqual((found.header.stamp - stamp).to_sec(), 0.0, delta=1e-6)
            T_world_laser = planar.lift(self.robot.pose(stamp.to_sec())) @ T_base_laser
            seen = np.linalg.inv(T_world_laser) @ [5.0, 3.0, 0.2, 1.0]
            hits.append(matrix_from_transform(found.transform) @ seen)
            time.sleep(0.05)
        self.assertLess(np.ptp(hits, axis=0).max(), 0.02)

    def test_tf_is_the_odometry_and_every_frame_has_one_parent(self):
        message = self.recent(0.2)[-1]
        found = self.listener.buffer.lookup_transform("odom", "base_link", message.header.stamp, rospy.Duration(1.0))
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
            self.assertLess(self.listener.wait_for_level("fusion_node", WARN), 1.2)
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
            self.assertLess(self.listener.wait_for_level("wheel_odometry_node", ERROR), 1.2)
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
        pose = RelativePose(10**6, Pose())
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

    def test_reset_of_the_fusion(self):
        self.drive_away(self.listener.poses)
        first = len(self.listener.poses)
        self.assertTrue(service("fusion_node/reset", Trigger)().success)
        self.listener.wait_for_jump(self.listener.poses, first, [0.0, 0.0], 0.3)
        self.listener.wait_for_scale(self.robot)

    def test_reset_of_the_wheels_does_not_move_the_fused_pose(self):
        self.drive_away(self.listener.wheel_poses)
        first = len(self.listener.wheel_poses)
        before = self.recent(0.1)[-1]
        self.assertTrue(service("wheel_odometry_node/reset", Trigger)().success)
        self.listener.wait_for_jump(self.listener.wheel_poses, first, [0.0, 0.0], 0.2)
        after = self.recent(0.2)[-1]
        driven_s = (after.header.stamp - before.header.stamp).to_sec()
        self.assertLess(np.linalg.norm(planar.between(xy_yaw(before), xy_yaw(after))[:2]), SPEED_M_S * driven_s + 0.3)

    def test_set_pose(self):
        set_pose = service("fusion_node/set_pose", SetPose)
        self.assertFalse(set_pose(PoseStamped(Header(frame_id="mars"), any_pose(1.0, 2.0, 0.5))).success)
        self.assertFalse(set_pose(PoseStamped(Header(frame_id="odom"), any_pose(float("nan"), 0.0, 0.0))).success)
        first = len(self.listener.poses)
        self.assertTrue(set_pose(PoseStamped(Header(frame_id="odom"), any_pose(10.0, 20.0, 0.5))).success)
        self.listener.wait_for_jump(self.listener.poses, first, [10.0, 20.0], 0.5)

    def test_save_trajectory(self):
        self.recent(2.0)  # ten keyframes; the test before may have begun anew
        save = service("fusion_node/save_trajectory", SaveTrajectory)
        with tempfile.TemporaryDirectory() as folder:
            answer = save(str(Path(folder) / "new"))
            self.assertTrue(answer.success, answer.message)
            for name in ("wheel", "fused", "fused_smoothed"):
                self.assertGreater(len(read_tum(Path(folder) / "new" / f"{name}.tum")), 5)
        answer = save("/proc/nowhere")
        self.assertFalse(answer.success)
        self.assertIn("/proc/nowhere", answer.message)

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
        for messages in together[-20:]:
            stamp, x = messages[2].header.stamp, messages[2].pose.pose.position.x
            self.assertEqual(sent[stamp].transform.translation.x, x)
            found = self.listener.buffer.lookup_transform("odom", "base_link", stamp, rospy.Duration(1.0))
            self.assertAlmostEqual(found.transform.translation.x, x, places=6)
        subscriber.unregister()

    def test_covariance_scale_while_driving(self):
        client = Client("fusion_node")
        before = self.recent(0.2)[-1]
        try:
            client.update_configuration({"covariance_scale": 1e6})
            self.assertEqual(rospy.get_param("fusion_node/covariance_scale"), 1e6)
            after = self.recent(0.2)[-1]
        finally:
            client.update_configuration({"covariance_scale": 1.0})
        for one, other in ((before.pose, after.pose), (before.twist, after.twist)):
            variances = [np.diagonal(np.reshape(each.covariance, (6, 6)))[[0, 5]] for each in (one, other)]
            self.assertGreater((variances[1] / variances[0]).min(), 1e4)  # they go up and down by themselves, too

    def test_output_while_driving(self):
        """A correction that may be large is worked in sooner; the pose does not jump beyond it."""
        client = Client("fusion_node/output")
        known = client.get_configuration()
        try:
            client.update_configuration({"blend_s": 0.01, "max_correction_m": 0.1})
            self.assertEqual(rospy.get_param("fusion_node/output/blend_s"), 0.01)
            self.assertEqual(rospy.get_param("fusion_node/output/max_correction_rad"), known["max_correction_rad"])
            poses = self.recent(1.0)
        finally:
            client.update_configuration({name: known[name] for name in ("blend_s", "max_correction_m")})
        steps = [planar.between(xy_yaw(a), xy_yaw(b)) for a, b in zip(poses, poses[1:])]
        self.assertLess(np.abs(steps).max(), 0.03)
        self.assertEqual(self.listener.statuses[-1].resets, self.listener.statuses[0].resets)

    def test_what_is_out_of_range_is_refused_and_nothing_changes(self):
        client = Client("fusion_node/output")
        with self.assertRaises(DynamicReconfigureCallbackException):
            client.update_configuration({"blend_s": 100.0, "max_correction_m": 0.05})
        self.assertEqual(rospy.get_param("fusion_node/output/blend_s"), 0.1)
        self.assertEqual(rospy.get_param("fusion_node/output/max_correction_m"), 0.005)

    def test_misspelt_parameters_are_refused_in_one_line(self):
        for node, parameter, complaint in (
            ("fusion_node", "_publish_ft:=false", "/refused: publish_ft is unknown; did you mean publish_tf?"),
            ("fusion_node", "_outputs/blend_s:=1", "outputs/blend_s is unknown; did you mean output/blend_s?"),
            ("wheel_odometry_node", "_wheels/radius_sigm:=1", "did you mean wheels/radius_sigma?"),
            ("wheel_odometry_node", "_silence:=2", "/refused/robot: has no ticks_per_turn"),
        ):
            command = ["rosrun", "ceiling_dso_ros", node, "__name:=refused", parameter]
            ended = subprocess.run(command, capture_output=True, text=True, timeout=60)
            rospy.delete_param("refused")
            self.assertEqual(ended.returncode, 2)
            self.assertIn(complaint, ended.stderr)
            self.assertEqual(len(ended.stderr.strip().splitlines()), 1)

    def test_y_restart_of_each_node(self):
        Client("fusion_node").update_configuration({"path_length": 123})
        for node in ("wheel_odometry_node", "fusion_node"):
            end_node(f"/{node}")
            self.listener.diagnostics.pop(node, None)
            self.listener.wait_for_level(node, OK)
            self.listener.wait_for_level("fusion_node", OK)
            self.listener.wait_for_scale(self.robot)
        self.assertEqual(Client("fusion_node").get_configuration()["path_length"], 123)  # what was set stays set

    def test_y_restart_while_no_keyframes_are_made(self):
        """As while the robot stands: the latched window is enough to see by."""
        self.robot.keyframes = False
        try:
            end_node("/fusion_node")
            first = len(self.listener.scales)
            wait_until(
                lambda: any(scale.segment == 0 for scale in self.listener.scales[first:]), "the window is not used"
            )
        finally:
            self.robot.keyframes = True
        self.listener.wait_for_scale(self.robot)

    def test_y_restart_with_the_window_of_another_run(self):
        """It is still latched when a bag is played again: a window from the future must not hide the new ones."""
        self.robot.keyframes = False
        try:
            self.robot.publish_window_of_another_run()
            end_node("/fusion_node")
            first = len(self.listener.scales)
            wait_until(lambda: len(self.listener.scales) > first, "fusion_node does not come back")
        finally:
            self.robot.keyframes = True
        wait_until(lambda: any(scale.converged for scale in self.listener.scales[first:]), "the camera is not used")
        self.listener.wait_for_scale(self.robot)

    def test_z_another_parent_of_the_base(self):
        """The fusion steps back, so that the base does not jump between two parents."""
        driver = tf2_ros.TransformBroadcaster()
        transform = TransformStamped(header=Header(frame_id="odom"), child_frame_id="base_link")
        transform.transform.rotation.w = 1.0
        deadline = time.monotonic() + 20.0
        while self.listener.level("fusion_node") != ERROR and time.monotonic() < deadline:
            transform.header.stamp = rospy.Time.now()
            driver.sendTransform(transform)
            time.sleep(0.05)
        self.assertEqual(self.listener.level("fusion_node"), ERROR)
        self.assertIn("tf_mode", self.listener.diagnostics["fusion_node"].message)
        self.assertEqual(parents("base_link"), set())


if __name__ == "__main__":
    rospy.init_node("fusion_rostest")
    rostest.rosrun("ceiling_dso_ros", "fusion", Fusion, sys.argv)
