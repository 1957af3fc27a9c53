# SPDX-License-Identifier: BSD-3-Clause
"""Loads the compiled kernels of the odometry before a node starts to work."""

import threading
import time
from typing import List

import rospy

from ceiling_dso_ros.dso import warmup


def load_kernels() -> None:
    """Have all kernels ready before the first image; returns early when the node is shut down.

    Raises:
        Exception: the error of the compilation or the loading.
    """
    errors: List[Exception] = []

    def load() -> None:
        try:
            warmup.load_kernels(rospy.loginfo)
        except Exception as error:  # goes on in the main thread
            errors.append(error)

    start_s = time.monotonic()
    work = threading.Thread(target=load, daemon=True)
    work.start()
    while work.is_alive() and not rospy.is_shutdown():
        work.join(0.1)
    if errors:
        raise errors[0]
    if not rospy.is_shutdown():
        rospy.loginfo(f"kernels ready after {time.monotonic() - start_s:.1f} s")
