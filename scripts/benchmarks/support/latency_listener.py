# SPDX-License-Identifier: BSD-3-Clause
"""Records when messages arrive while a bag is played, and writes the times as JSON when it is stopped.

Run with ROS's environment by `support/node_latency.py`. It does not subscribe to the images: that would cost as
much as the nodes' own subscription.
"""

import json
import sys
import time
from pathlib import Path
from typing import Any, Dict

import rospy
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import CameraInfo

from ceiling_dso_ros.msg import VisualOdometryStatus

TOPICS = {
    "images": ("camera/up/camera_info", CameraInfo),
    "poses": ("visual_odometry/pose", PoseStamped),
    "statuses": ("visual_odometry/status", VisualOdometryStatus),
}


def main() -> None:
    """Listen; then write wall times in seconds, by topic and stamp in nanoseconds, to the file that is named."""
    heard: Dict[str, Dict[int, float]] = {name: {} for name in TOPICS}

    def note(message: Any, name: str) -> None:  # noqa: ANN401
        arrival_s = time.time()
        heard[name][message.header.stamp.to_nsec()] = arrival_s

    rospy.init_node("latency_listener", disable_rostime=True)
    for name, (topic, kind) in TOPICS.items():
        rospy.Subscriber(topic, kind, note, callback_args=name, queue_size=None, tcp_nodelay=True)
    rospy.spin()
    Path(sys.argv[1]).write_text(json.dumps(heard))


if __name__ == "__main__":
    main()
