# SPDX-License-Identifier: BSD-3-Clause
"""Listens to a simulated bag that is played until it is told to stop, then prints what has arrived as JSON."""

import json
import sys
from collections import Counter

import rospy
import tf2_ros
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CameraInfo, Image, JointState, LaserScan
from std_msgs.msg import Int32

TYPES = {
    "/camera/up/image_raw": Image,
    "/camera/up/camera_info": CameraInfo,
    "/camera/up/exposure": rospy.AnyMsg,  # this package's own type: needs no built workspace so
    "/joint_states": JointState,
    "/wheel/left/ticks": Int32,
    "/wheel/right/ticks": Int32,
    "/odom": Odometry,
    "/scan": LaserScan,
    "/ground_truth": PoseStamped,
}


def transform(buffer, target, source):
    """[x, y, z, qx, qy, qz, qw] of T_target_source."""
    t = buffer.lookup_transform(target, source, rospy.Time(0)).transform
    p, q = t.translation, t.rotation
    return [p.x, p.y, p.z, q.x, q.y, q.z, q.w]


def main():
    """Count until the process is told to stop."""
    rospy.init_node("bag_listener")
    counts = Counter()
    buffer = tf2_ros.Buffer()
    tf2_ros.TransformListener(buffer)
    for topic, kind in TYPES.items():
        rospy.Subscriber(topic, kind, lambda _, topic=topic: counts.update([topic]), queue_size=None)
    rospy.spin()
    transforms = {
        f"{target} {source}": transform(buffer, target, source)
        for target, source in (("base_link", "camera_up_optical_frame"), ("base_link", "laser"), ("map", "odom"))
    }
    json.dump({"counts": counts, "transforms": transforms}, sys.stdout)


if __name__ == "__main__":
    main()
