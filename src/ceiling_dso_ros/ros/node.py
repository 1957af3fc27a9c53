# SPDX-License-Identifier: BSD-3-Clause
"""Runs a node; common to all executables."""

import sys
import threading
import time
from contextlib import contextmanager
from typing import Callable, Iterator

import rospy

from ceiling_dso_ros.dso.durations import nanoseconds
from ceiling_dso_ros.io.errors import InputError, OutputError
from ceiling_dso_ros.ros.heap import use_one_heap

NO_CLOCK_S = 10.0  # a playback begins later than the nodes


def run_node(name: str, make_server: Callable) -> int:
    """Run a server until the node is shut down; returns the exit code.

    Args:
        name: of the node, unless it is remapped.
        make_server: gives an object with `spin()`, or raises InputError where a parameter is wrong.
    """
    use_one_heap()
    rospy.init_node(name)
    watch = threading.Timer(NO_CLOCK_S, _warn_without_clock)
    watch.daemon = True
    watch.start()
    try:
        make_server().spin()
    except (InputError, OutputError) as error:
        if rospy.is_shutdown():  # logging has ended
            print(error, file=sys.stderr)
        else:
            rospy.logfatal("%s", error)
        return 2
    return 0


def _warn_without_clock() -> None:
    """Say that time stands still: the parameter of a playback that has ended stays on the master."""
    if time_is_simulated() and rospy.get_time() == 0.0 and not rospy.is_shutdown():
        rospy.logwarn(
            "/use_sim_time is true, but nobody publishes /clock, so that time stands still; on a robot: rosparam set "
            "/use_sim_time false, and start the nodes again; with a bag: rosbag play --clock"
        )


@contextmanager
def publishing() -> Iterator[None]:
    """Publish in the block; that topics are closed while the node is shut down is no error."""
    try:
        yield
    except rospy.ROSException:
        if not rospy.core.is_shutdown_requested():
            raise


def time_is_simulated() -> bool:
    """Whether the nodes live in the time of a bag or a simulation, which may begin again."""
    return bool(rospy.get_param("/use_sim_time", False))


def arrival_clock(is_simulated: bool) -> Callable[[], int]:
    """A clock that gives nanoseconds and is never set; where time is simulated, it stands still as that does."""
    return (lambda: nanoseconds(rospy.get_time())) if is_simulated else time.monotonic_ns
