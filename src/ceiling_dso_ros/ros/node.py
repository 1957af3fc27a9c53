# SPDX-License-Identifier: BSD-3-Clause
"""Runs a node; common to all executables."""

import sys
from contextlib import contextmanager
from typing import Callable, Iterator

import rospy

from ceiling_dso_ros.io.errors import InputError, OutputError


def run_node(name: str, make_server: Callable) -> int:
    """Run a server until the node is shut down; returns the exit code.

    Args:
        name: of the node, unless it is remapped.
        make_server: gives an object with `spin()`, or raises InputError where a parameter is wrong.
    """
    rospy.init_node(name)
    try:
        make_server().spin()
    except (InputError, OutputError) as error:
        if rospy.is_shutdown():  # logging has ended
            print(error, file=sys.stderr)
        else:
            rospy.logfatal("%s", error)
        return 2
    return 0


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
