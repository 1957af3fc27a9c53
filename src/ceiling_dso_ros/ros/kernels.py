"""The compiled kernels of the odometry, ready before a node begins to work."""

import threading

import rospy

from ceiling_dso_ros.dso.warmup import warm_up


def load_kernels() -> None:
    """Have all kernels ready before the first image; returns early when the node is shut down.

    They are compiled when the package runs for the first time, which takes a minute or two.
    """
    rospy.loginfo("loading the kernels; the first start compiles them, which takes a minute or two")
    work = threading.Thread(target=warm_up, daemon=True)
    work.start()
    while work.is_alive() and not rospy.is_shutdown():
        work.join(0.1)
