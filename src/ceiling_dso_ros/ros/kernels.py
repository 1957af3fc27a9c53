# SPDX-License-Identifier: BSD-3-Clause
"""Loads compiled kernels before a node starts to work."""

import threading
import time
from typing import Callable, List

import rospy


def load_kernels(load_with: Callable[[Callable[[str], None]], None]) -> None:
    """Have all kernels ready before the first message; returns early when the node is shut down.

    Args:
        load_with: `load_kernels` of a warm-up.

    Raises:
        Exception: the error of the compilation or the loading.
    """
    errors: List[Exception] = []

    def load() -> None:
        try:
            load_with(rospy.loginfo)
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
