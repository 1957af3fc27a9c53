#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""Services, parameters and restarts of wheel_odometry_node and fusion_node while the robot drives."""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import rospy
import rostest
import tf2_ros
from diagnostic_msgs.msg import DiagnosticStatus
from driving_robot import DrivingRobot, service
from dynamic_reconfigure import DynamicReconfigureCallbackException
from dynamic_reconfigure.client import Client
from fake_robot import (
    SPEED_M_S,
    any_pose,
    end_node,
    parents,
    pid_of,
    xy_yaw,
)
from geometry_msgs.msg import PoseStamped, TransformStamped
from std_msgs.msg import Header
from std_srvs.srv import Trigger
from waiting import wait_until

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.io.trajectory import read_tum
from ceiling_dso_ros.playback.spool_files import write_all
from ceiling_dso_ros.srv import SaveTrajectory, SetPose

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


class FusionOperation(DrivingRobot):
    """The tests share the nodes; the robot drives on through all of them."""

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
            client.update_configuration({"blend_s": 0.01, "max_correction_m_s": 5.0})
            self.assertEqual(rospy.get_param("fusion_node/output/blend_s"), 0.01)
            self.assertEqual(rospy.get_param("fusion_node/output/max_correction_rad_s"), known["max_correction_rad_s"])
            poses = self.recent(1.0)
        finally:
            client.update_configuration({name: known[name] for name in ("blend_s", "max_correction_m_s")})
        steps = [planar.between(xy_yaw(a), xy_yaw(b)) for a, b in zip(poses, poses[1:])]
        self.assertLess(np.abs(steps).max(), 0.03)
        self.assertEqual(self.listener.statuses[-1].resets, self.listener.statuses[0].resets)

    def test_what_is_out_of_range_is_refused_and_nothing_changes(self):
        client = Client("fusion_node/output")
        with self.assertRaises(DynamicReconfigureCallbackException):
            client.update_configuration({"blend_s": 100.0, "max_correction_m_s": 0.05})
        self.assertEqual(rospy.get_param("fusion_node/output/blend_s"), 0.1)
        self.assertEqual(rospy.get_param("fusion_node/output/max_correction_m_s"), 0.25)

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

    def test_y_kill(self):
        """It goes on at once, and its trajectories are there but for the last second."""
        self.recent(3.0)
        base = Path(os.environ.get("ROS_HOME") or Path.home() / ".ros") / "ceiling_dso_ros"
        pid = pid_of("/fusion_node")
        kept = min(base.glob(f"fusion_node.*.{pid}.spool"))  # later ones are of runs that were ended by ~reset
        self.addCleanup(shutil.rmtree, kept)
        os.kill(pid, signal.SIGKILL)
        first = len(self.listener.scales)
        wait_until(lambda: len(self.listener.scales) > first, "fusion_node does not come back")
        self.listener.wait_for_scale(self.robot)
        with tempfile.TemporaryDirectory() as folder:
            written = write_all(kept, Path(folder))
            self.assertEqual(written.errors, [])
            self.assertGreater(min(written.poses.values()), 5)
            self.assertEqual(len(written.poses), 3)

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
    rostest.rosrun("ceiling_dso_ros", "fusion_operation", FusionOperation, sys.argv)
