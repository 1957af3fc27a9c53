# SPDX-License-Identifier: BSD-3-Clause
"""Records when poses of odometry/filtered arrive, and writes the times when it is stopped: pose_listener.py FILE.json.

In a process that does nothing else: one that renders images hears late.
"""

import json
import sys
import time
from pathlib import Path
from typing import List

import rospy
from nav_msgs.msg import Odometry


def main() -> None:
    """Listen; then write seconds of the monotonic clock, which all processes share."""
    arrivals_s: List[float] = []
    rospy.init_node("pose_listener", disable_rostime=True)
    rospy.Subscriber(
        "odometry/filtered", Odometry, lambda _: arrivals_s.append(time.monotonic()), queue_size=None, tcp_nodelay=True
    )
    rospy.spin()
    Path(sys.argv[1]).write_text(json.dumps(arrivals_s))


if __name__ == "__main__":
    main()
