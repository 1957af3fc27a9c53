#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""One launch file from a camera that is plugged in to odometry/filtered: a rendered drive is what the camera sees."""

import os
import shutil
import time
import unittest
from pathlib import Path

import numpy as np
import rospy
import rostest
from fake_bench import FakeBench, now_raw_s
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from ceiling_dso_ros.msg import FusionStatus, VisualOdometryStatus
from ceiling_dso_ros.ros.conversions import pose_from_matrix, ros_time
from ceiling_dso_ros.simulation.bag import WHEEL_JOINTS
from ceiling_dso_ros.simulation.camera import CameraModel
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.sensors.measurements import CameraFrame, WheelReading
from ceiling_dso_ros.simulation.simulation import Simulation

DURATION_S, RATE_HZ = 20.0, 15
LEAD_S = 3.0  # from plugging the camera in to the first image of the drive
PATIENCE_S = 180.0
CAMERA_FRAME = "camera_up_optical_frame"


def wait_until(condition, complaint):
    end_s = time.monotonic() + PATIENCE_S
    while not condition():
        if time.monotonic() > end_s:
            raise AssertionError(complaint())
        time.sleep(0.05)


class RealsenseOdometryTest(unittest.TestCase):
    def setUp(self):
        rospy.init_node("realsense_odometry_test")
        self.bench = FakeBench(Path(os.environ["FAKE_REALSENSE"]))
        self.poses, self.tracked, self.messages = [], 0, set()
        rospy.Subscriber("odometry/filtered", Odometry, self.poses.append)
        rospy.Subscriber("visual_odometry/status", VisualOdometryStatus, self._on_status)
        rospy.Subscriber("fusion/status", FusionStatus, lambda message: setattr(self, "fusion", message))
        self.joints = rospy.Publisher("joint_states", JointState, queue_size=100)
        self.fusion = None

    def tearDown(self):
        shutil.rmtree(self.bench.folder, ignore_errors=True)

    def _on_status(self, status):
        self.tracked += status.state == VisualOdometryStatus.TRACKING
        self.messages.add(status.message)

    def test_a_drive(self):
        camera = CameraModel(width=424, height=240, fps=float(RATE_HZ))
        simulation = Simulation(SimulationConfig("loops", "factory", camera=camera, duration_s=DURATION_S))
        measurements = list(simulation.measurements())
        frames = [each for each in measurements if isinstance(each, CameraFrame)]
        readings = [each for each in measurements if isinstance(each, WheelReading)]
        start_ns = measurements[0].stamp_ns
        drive = self.bench.folder / "drive.npz"
        np.savez(
            drive,
            images=[frame.image for frame in frames],
            exposures_ms=[frame.exposure_ms for frame in frames],
            times_s=[LEAD_S + 1e-9 * (frame.stamp_ns - start_ns) for frame in frames],
        )
        self._publish_mount(simulation)
        wait_until(lambda: self.joints.get_num_connections() > 0, lambda: "nobody listens to the wheels")
        self.bench.plug_in(drive=str(drive), on_s=now_raw_s(), modes=[[424, 240, RATE_HZ]])
        origin_s, origin_ns = time.monotonic() + LEAD_S, time.time_ns() + round(1e9 * LEAD_S)
        for reading in readings:
            elapsed_ns = reading.stamp_ns - start_ns
            time.sleep(max(0.0, origin_s + 1e-9 * elapsed_ns - time.monotonic()))
            header = Header(stamp=ros_time(origin_ns + elapsed_ns))
            self.joints.publish(JointState(header, WHEEL_JOINTS, reading.angles_rad.tolist(), [], []))
        wait_until(
            lambda: bool(self.poses) and self.poses[-1].header.stamp.to_nsec() >= origin_ns + elapsed_ns,
            lambda: f"{len(self.poses)} poses; fusion says {self.fusion}",
        )
        self.assertGreater(self.tracked, 30, f"the camera is not tracked: {self.messages}")
        self.assertEqual(self.fusion.state, FusionStatus.CONVERGED, str(self.fusion))
        true_start, true_end = (reading.T_world_base for reading in (readings[0], readings[-1]))
        expected = (np.linalg.inv(true_start) @ true_end)[:2, 3]
        position = self.poses[-1].pose.pose.position
        self.assertLess(np.linalg.norm(expected - [position.x, position.y]), 0.1)

    def _publish_mount(self, simulation):
        T_base_camera = simulation.robot.static_transforms()[CAMERA_FRAME]
        pose = pose_from_matrix(T_base_camera)
        transform = TransformStamped(header=Header(frame_id="base_link"), child_frame_id=CAMERA_FRAME)
        transform.transform.translation.x, transform.transform.translation.y = pose.position.x, pose.position.y
        transform.transform.translation.z, transform.transform.rotation = pose.position.z, pose.orientation
        publisher = rospy.Publisher("/tf_static", TFMessage, queue_size=1, latch=True)
        publisher.publish(TFMessage([transform]))
        self.mount = publisher


if __name__ == "__main__":
    rostest.rosrun("ceiling_dso_ros", "realsense_odometry", RealsenseOdometryTest)
