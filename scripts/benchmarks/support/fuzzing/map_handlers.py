# SPDX-License-Identifier: BSD-3-Clause
"""Targets that are map_node: wrong keyframes, poses and map files, between good ones."""

import itertools
import os
import sys
from pathlib import Path
from random import Random
from typing import Any, Callable, Iterator, List, Tuple

import pytest
from support.checkout import CHECKOUT
from support.fuzzing import maps
from support.fuzzing.nodes import Message, Node, wrong
from support.fuzzing.rules import require_clear_line
from support.fuzzing.runner import Case

sys.path.insert(0, str(CHECKOUT / "test" / "ros"))
sys.path.insert(0, str(CHECKOUT / "test" / "slam"))

import painted_ceiling as ceiling
import rospy
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from std_msgs.msg import Header
from told_drive import ToldDrive, left_message

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.ros.conversions import pose_from_matrix, ros_time
from ceiling_dso_ros.ros.keyframe_messages import view_message
from ceiling_dso_ros.ros.map_server import MapServer
from ceiling_dso_ros.srv import LoadMapRequest, SaveMapRequest

VIEWS, LEFT, ODOMETRY = "visual_odometry/views", "fusion/left_keyframes", "odometry/filtered"
STATUS = "map/status"
LAPS = 3  # of the drive, which begins again after them
POSES = ceiling.round_trip(1.6, LAPS, 18)
BEGIN_NS, NEXT_DRIVE_NS = 10**18, 3600 * 10**9


class Map(Node):
    """The robot drives in circles."""

    def __init__(self, patch: pytest.MonkeyPatch, **private: object) -> None:
        super().__init__(patch, **private)
        self.world.listened |= {"map/keyframes", "map/points", "map/loops", "map/hypotheses"}
        patch.setattr("ceiling_dso_ros.ros.map_server.load_kernels", lambda _load: None)
        patch.setattr("ceiling_dso_ros.ros.map_frame.Periodic", lambda *_: None)
        patch.setattr("ceiling_dso_ros.ros.site_publisher.Periodic", lambda *_: None)
        patch.setattr(rospy.Time, "now", lambda: self.odometry().header.stamp)
        self.server = MapServer()
        self.refused = 0  # maps that were not loaded
        self._texture, self._drives = ceiling.paint(10), itertools.count()
        self._next = self._keyframes()
        for _ in range(4):
            self.good()

    def _keyframes(self) -> Iterator[Tuple[ToldDrive, int]]:
        for number in self._drives:
            odom = ceiling.drifted(POSES, seed=number)
            drive = ToldDrive(self._texture, POSES, odom, BEGIN_NS + number * NEXT_DRIVE_NS, number)
            yield from ((drive, i) for i in range(len(drive)))

    def view(self) -> Message:
        """What the next keyframe shows."""
        drive, i = self.newest
        return view_message(drive.view(i), drive.stamp_ns(i), "camera")

    def left(self) -> Message:
        """Where it is."""
        drive, i = self.newest
        return left_message(drive.left(i))

    def odometry(self) -> Message:
        """The pose then."""
        drive, i = self.newest
        message = Odometry(header=Header(stamp=ros_time(drive.newest_ns(i)), frame_id="odom"))
        message.pose.pose = pose_from_matrix(planar.lift(drive.newest(i)[1]))
        return message

    def advance(self) -> None:
        """The next keyframe leaves the window."""
        self.index += 1
        self.newest = next(self._next)

    def good(self) -> None:
        """See Node."""
        self.advance()
        self.hear_all((ODOMETRY, self.odometry()), (VIEWS, self.view()), (LEFT, self.left()))

    def hear_all(self, *messages: Tuple[str, Message]) -> None:
        """Receive messages, and work on them as the node's main loop does."""
        for topic, message in messages:
            self.world.callbacks[topic](message)
        while not self.server._work.empty():
            self.server._use(self.server._work.get_nowait())
        self.server._publisher._show()

    @property
    def outputs(self) -> int:
        """See Node."""
        return int(self.world.sent.get(STATUS, 0))

    @property
    def rejected(self) -> int:
        """See Node."""
        return int(self.server._views.rejected + self.server._poses.rejected + self.refused)


def _view(node: Map, random: Random) -> Case:
    node.advance()
    message, left = wrong(random, node.view()), node.left()
    return message, lambda: node.use(lambda: node.hear_all((VIEWS, message), (LEFT, left)))


def _left(node: Map, random: Random) -> Case:
    node.advance()
    message, view = wrong(random, node.left()), node.view()
    return message, lambda: node.use(lambda: node.hear_all((VIEWS, view), (LEFT, message)))


def _odometry(node: Map, random: Random) -> Case:
    node.advance()
    message, view, left = wrong(random, node.odometry()), node.view(), node.left()
    return message, lambda: node.use(lambda: node.hear_all((ODOMETRY, message), (VIEWS, view), (LEFT, left)))


def _initial_pose(node: Map, random: Random) -> Case:
    pose = PoseWithCovarianceStamped(header=Header(frame_id="map"))
    pose.pose.pose.orientation.w = 1.0
    pose.pose.covariance = [0.1 if i % 7 == 0 else 0.0 for i in range(36)]
    message = wrong(random, pose)
    return message, lambda: node.hear("initialpose", message)


def _load_map(node: Map, random: Random) -> Case:
    content = maps.mutated_map(random)
    folder = Path(os.environ["ROS_HOME"])
    path = folder / maps.NAME

    def load() -> None:
        folder.mkdir(exist_ok=True)
        path.write_bytes(content)
        loaded = node.world.services["~load_map"](LoadMapRequest(str(path)))
        saved = node.world.services["~save_map"](SaveMapRequest(str(folder / "saved")))
        for answer in (loaded, saved):
            require_clear_line(answer.message)
        node.refused += not loaded.success

    return content, lambda: node.use(load)


TARGETS: List[Tuple[str, int, Callable[[Any, Random], Case]]] = [
    ("view of a keyframe", 300, _view),
    ("left keyframe", 400, _left),
    ("odometry of the map", 100, _odometry),
    ("initialpose", 200, _initial_pose),
    ("load_map", 200, _load_map),
]
