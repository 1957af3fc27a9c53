#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""Stands for ekf_localization_node or move_base, whose parameters it reads, and for the wheels' driver.

Writes what it has found into the file that STAND_IN_RESULT names, once enough has been heard: the odometry's frames,
and who has published which transforms.
"""

import json
import os
from pathlib import Path

import rospy
import tf2_ros
from geometry_msgs.msg import TransformStamped, Twist
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

HZ, ENOUGH = 50, 100  # messages of the odometry


class StandIn:
    """One of the two, by the node's name."""

    def __init__(self):
        self.found = {"odometry": [], "transforms": []}
        self.is_ekf = rospy.get_name() == "/ekf_localization"
        topics = ("odom0",) if self.is_ekf else ("TrajectoryPlannerROS/odom_topic", "DWAPlannerROS/odom_topic")
        for topic in topics:
            rospy.Subscriber(rospy.get_param(f"~{topic}"), Odometry, self.on_odometry, callback_args=topic)
        rospy.Subscriber("/tf", TFMessage, self.on_tf)
        self.joints = rospy.Publisher("joint_states", JointState, queue_size=10)
        if self.is_ekf:
            self.frames = [rospy.get_param(f"~{frame}") for frame in ("world_frame", "base_link_frame")]
            self.filtered = rospy.Publisher("odometry/filtered", Odometry, queue_size=10)
            self.broadcaster = tf2_ros.TransformBroadcaster()
        else:
            self.commands = rospy.Publisher("cmd_vel", Twist, queue_size=10)

    def on_odometry(self, message, topic):
        sender = message._connection_header["callerid"]
        self.found["odometry"].append([topic, sender, message.header.frame_id, message.child_frame_id])

    def on_tf(self, message):
        for transform in message.transforms:
            pair = [message._connection_header["callerid"], transform.header.frame_id, transform.child_frame_id]
            if pair not in self.found["transforms"]:
                self.found["transforms"].append(pair)

    def run(self):
        angle, rate = 0.0, rospy.Rate(HZ)
        while not rospy.is_shutdown():
            header = Header(stamp=rospy.Time.now())
            angle += 2.0 / HZ
            self.joints.publish(JointState(header, ["left_wheel", "right_wheel"], [angle, angle], [], []))
            if self.is_ekf:
                self.publish_filtered(header.stamp)
            if len(self.found["odometry"]) >= ENOUGH:
                unique = {name: sorted({tuple(row) for row in rows}) for name, rows in self.found.items()}
                partial = Path(os.environ["STAND_IN_RESULT"] + ".part")
                partial.write_text(json.dumps(unique))
                partial.rename(os.environ["STAND_IN_RESULT"])
            rate.sleep()

    def publish_filtered(self, stamp):
        transform = TransformStamped(header=Header(stamp=stamp, frame_id=self.frames[0]), child_frame_id=self.frames[1])
        transform.transform.rotation.w = 1.0
        self.broadcaster.sendTransform(transform)
        self.filtered.publish(Odometry(header=transform.header, child_frame_id=self.frames[1]))


if __name__ == "__main__":
    rospy.init_node("stand_in")
    StandIn().run()
