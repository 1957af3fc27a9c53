# SPDX-License-Identifier: BSD-3-Clause
"""Targets that are the nodes: wrong messages, between good ones, to servers without a master.

A handler may raise nothing. After each wrong message the node must go on with good ones, and what it publishes must be
finite, and such that it can be sent.
"""

import itertools
import sys
from contextlib import contextmanager
from pathlib import Path
from random import Random
from typing import Any, Callable, Dict, Iterator, List

import cv2
import numpy as np
import pytest
from support.checkout import CHECKOUT
from support.fuzzing import map_handlers
from support.fuzzing.mutations import mutated_tree
from support.fuzzing.nodes import Message, Node, World, wrong
from support.fuzzing.recordings import picture, stamp_ns, visual_status
from support.fuzzing.rules import outcome_of, require_clear_line
from support.fuzzing.runner import Case, Target

sys.path.insert(0, str(CHECKOUT / "test" / "ros"))

import rospy
import tf2_ros
from geometry_msgs.msg import PoseStamped, TransformStamped
from nav_msgs.msg import Odometry
from rosless import parameters_of
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, JointState, PointCloud2
from std_msgs.msg import Header, Int32
from tf2_msgs.msg import TFMessage

from ceiling_dso_ros.dso.config import OdometryConfig
from ceiling_dso_ros.fusion.config import FusionConfig
from ceiling_dso_ros.msg import Exposure, Keyframes, MotionPrediction
from ceiling_dso_ros.ros import parameters
from ceiling_dso_ros.ros.conversions import pose_from_matrix, ros_time, status_message
from ceiling_dso_ros.ros.dso_server import DsoServer
from ceiling_dso_ros.ros.fusion_server import FusionServer
from ceiling_dso_ros.ros.map_publisher import FIELDS
from ceiling_dso_ros.ros.node_parameters import DsoParameters, FusionParameters, WheelParameters
from ceiling_dso_ros.ros.robot_parameter import ROBOT_GROUP, read_robot
from ceiling_dso_ros.ros.wheel_server import WheelServer
from ceiling_dso_ros.settings import plain_values
from ceiling_dso_ros.srv import SetPoseRequest

ROBOT = {"ticks_per_turn": 4096.0, "wheel_radius": [0.1, 0.1], "wheel_base": 0.5}
MOUNT = {"xyz": [0.0, 0.0, 0.5], "quat_xyzw": [0.0, 0.0, 0.0, 1.0]}
IMAGE_SIZE = (192, 160)

OUTPUT, WHEELS = "odometry/filtered", "wheel/odometry"
STATUS, KEYFRAMES, POINTS = "visual_odometry/status", "visual_odometry/keyframes", "visual_odometry/points"


class _Wheels(Node):
    def __init__(self, patch: pytest.MonkeyPatch, **private: object) -> None:
        super().__init__(patch, robot=ROBOT, **private)
        self.server = WheelServer()
        patch.setattr(rospy.Time, "now", lambda: ros_time(stamp_ns(self.index)))
        for _ in range(5):
            self.good()

    def message(self) -> Message:
        """The next one."""
        self.index += 1
        header = Header(stamp=ros_time(stamp_ns(self.index)))
        angle = 0.1 * self.index
        return JointState(header, ["left_wheel", "right_wheel"], [angle, angle], [1.0, 1.0], [])

    def good(self) -> None:
        """See Node."""
        if "joint_states" in self.world.callbacks:
            self.world.callbacks["joint_states"](self.message())
            return
        self.index += 1
        for side in ("left", "right"):
            self.world.callbacks[f"{side}/ticks"](Int32(50 * self.index))

    @property
    def outputs(self) -> int:
        """See Node."""
        return int(self.world.sent.get(WHEELS, 0))

    @property
    def rejected(self) -> int:
        """See Node."""
        return self.server._samples.rejected


class _Fusion(Node):
    def __init__(self, patch: pytest.MonkeyPatch, **private: object) -> None:
        super().__init__(patch, **{"robot": {**ROBOT, "T_base_camera": MOUNT}, **private})
        self.server = FusionServer()
        self.world.listened |= {"fusion/motion_prediction", "fusion/keyframes", "fusion/points"}
        self.server._map.peer_subscribe()
        for _ in range(80):
            self.good()

    def wheels(self) -> Message:
        """The next message of the wheels, twice as often as images."""
        self.index += 1
        T = np.eye(4)
        T[0, 3] = 0.012 * self.index
        message = Odometry(header=Header(stamp=ros_time(stamp_ns(self.index / 2)), frame_id="odom"))
        message.child_frame_id = "base_link"
        message.pose.pose = pose_from_matrix(T)
        return message

    def status(self) -> Message:
        """Of the newest image."""
        status = visual_status(self.index // 2)
        return status_message(Header(stamp=ros_time(status.stamp_ns), frame_id="vo"), status)

    def good(self) -> None:
        """See Node."""
        self.world.callbacks[WHEELS](self.wheels())
        if self.index % 2 == 0:
            self.world.callbacks[STATUS](self.status())

    @property
    def outputs(self) -> int:
        """See Node."""
        return int(self.world.sent.get(OUTPUT, 0))

    @property
    def rejected(self) -> int:
        """See Node."""
        return self.server._wheels.rejected + self.server._images.rejected


class _Camera(Node):
    def __init__(self, patch: pytest.MonkeyPatch, **private: object) -> None:
        super().__init__(patch, mapping="sequential", motion_prediction=True, **private)
        patch.setattr("ceiling_dso_ros.ros.dso_server.CALIBRATION_TIMEOUT_S", 0.0)
        self.server = DsoServer()
        self.world.callbacks["camera_info"](self.camera_info())
        for _ in range(12):
            self.good()

    def camera_info(self) -> Message:
        """Of the images."""
        width, height = IMAGE_SIZE
        K = [120.0, 0.0, width / 2, 0.0, 120.0, height / 2, 0.0, 0.0, 1.0]
        return CameraInfo(width=width, height=height, K=K, distortion_model="plumb_bob", D=[0.0] * 5)

    def header(self) -> Header:
        """Of the next image."""
        self.index += 1
        return Header(stamp=ros_time(stamp_ns(self.index)), frame_id="camera")

    def image(self) -> Message:
        """The next one."""
        header, (width, height) = self.header(), IMAGE_SIZE
        pixels = picture(self.index, width, height)
        if self.server._image_topic.endswith("/compressed"):
            return CompressedImage(header, "mono8; png compressed ", cv2.imencode(".png", pixels)[1].tobytes())
        return Image(header, height, width, "mono8", 0, width, pixels.tobytes())

    def good(self) -> None:
        """See Node."""
        self.world.callbacks["camera_info"](self.camera_info())
        self.process(self.image())

    def process(self, image: Message) -> None:
        """Receive an image, and work on it as the node's main loop does."""
        self.world.callbacks[self.server._image_topic](image)
        if self.server._mailbox._messages:  # refused images do not reach it, and the node would wait
            self.server._process_safely(self.server._mailbox.take())

    @property
    def outputs(self) -> int:
        """Images that were not refused."""
        return int(self.world.sent.get(STATUS, 0)) - self.rejected

    @property
    def rejected(self) -> int:
        """See Node."""
        return self.server._images.rejected


@contextmanager
def without_a_master(folder: Path) -> Iterator[List[Target]]:
    """All targets; the nodes keep their files in a folder."""
    patch, count = pytest.MonkeyPatch(), itertools.count()
    made: List[Any] = []

    def begin(
        kind: Callable[..., Any], make: Callable[[Any, Random], Case], **private: object
    ) -> Callable[[Random], Case]:
        while made:
            made.pop().world.end()
        patch.setenv("ROS_HOME", str(folder / f"ros{next(count)}"))
        node = kind(patch, **private)
        made.append(node)
        return lambda random: make(node, random)

    def target(
        name: str, count: int, kind: Callable[..., Any], make: Callable[[Any, Random], Case], **private: object
    ) -> Target:
        return Target(name, count, lambda: begin(kind, make, **private), has_state=True)

    patch.setattr(tf2_ros, "TransformBroadcaster", tf2_ros.TransformBroadcaster)  # so that it is put back at the end
    try:
        yield [
            target("joint_states", 1500, _Wheels, _joint_states),
            target("ticks", 300, _Wheels, _ticks, input="ticks"),
            target("wheel odometry", 1500, _Fusion, _wheel_odometry),
            target("visual status", 1500, _Fusion, _status),
            target("keyframes", 500, _Fusion, _keyframes),
            target("points", 300, _Fusion, _points),
            target("tf", 500, _Fusion, _tf),
            target("camera by tf", 300, _Fusion, _mount, robot=ROBOT),
            target("set_pose", 300, _Fusion, _set_pose),
            target("image", 600, _Camera, _image),
            target("compressed image", 300, _Camera, _image, image_transport="compressed"),
            target("camera_info", 600, _Camera, _camera_info),
            target("exposure", 300, _Camera, _exposure),
            target("motion prediction", 300, _Camera, _prediction),
            *(target(name, count, map_handlers.Map, make) for name, count, make in map_handlers.TARGETS),
            Target("parameters", 1000, lambda: _parameters(patch)),
        ]
    finally:
        while made:
            made.pop().world.end()
        patch.undo()


def _joint_states(node: _Wheels, random: Random) -> Case:
    message = wrong(random, node.message())
    return message, lambda: node.hear("joint_states", message)


def _ticks(node: _Wheels, random: Random) -> Case:
    side, message = random.choice(("left", "right")), wrong(random, Int32(50 * node.index))
    return (side, message), lambda: node.hear(f"{side}/ticks", message)


def _wheel_odometry(node: _Fusion, random: Random) -> Case:
    message = wrong(random, node.wheels())
    return message, lambda: node.hear(WHEELS, message)


def _status(node: _Fusion, random: Random) -> Case:
    node.index += node.index % 2
    if random.randrange(2):
        node.index += 10 - node.index % 10  # an image that is a keyframe
    message = wrong(random, node.status())
    return message, lambda: node.hear(STATUS, message)


def _keyframes(node: _Fusion, random: Random) -> Case:
    status = status_message(Header(stamp=ros_time(stamp_ns(node.index)), frame_id="vo"), visual_status(10))
    message = wrong(random, Keyframes(status.header, status.keyframes))

    def latched() -> None:
        node.server._start_anew()  # as a node that is started again
        node.good()
        node.world.callbacks[KEYFRAMES](message)

    return message, lambda: node.use(latched)


def _points(node: _Fusion, random: Random) -> Case:
    data = np.arange(16, dtype=np.float32).tobytes()
    header = Header(stamp=ros_time(stamp_ns(node.index / 2)), frame_id="vo")
    message = wrong(random, PointCloud2(header, 1, 4, FIELDS, False, 16, 64, data, True))
    return message, lambda: node.hear(POINTS, message)


def _tf(node: _Fusion, random: Random) -> Case:
    transform = TransformStamped(header=Header(frame_id="map"), child_frame_id="odom")
    transform.transform.rotation.w = 1.0
    message = wrong(random, TFMessage([transform, transform]))
    return message, lambda: node.hear("/tf", message)


def _mount(node: _Fusion, random: Random) -> Case:
    transform = TransformStamped(header=Header(frame_id="base_link"), child_frame_id="optical")
    transform.transform.rotation.w = 1.0
    message = wrong(random, transform)

    def find() -> None:
        mount = node.server._mount
        node.server._camera_known, mount._T_base_camera, mount._asked_s = False, None, -np.inf
        mount._listener = mount._listener or tf2_ros.TransformListener(mount._buffer)
        mount._buffer = _Buffer(message)
        node.good()

    return message, lambda: node.use(find)


class _Buffer:
    def __init__(self, transform: Message) -> None:
        self._transform = transform

    def lookup_transform(self, *_: object) -> Message:
        """The only one."""
        return self._transform


def _set_pose(node: _Fusion, random: Random) -> Case:
    pose = PoseStamped(header=Header(frame_id="odom"))
    pose.pose.orientation.w = 1.0
    message = wrong(random, pose)

    def set_pose() -> None:
        answer = node.world.services["~set_pose"](SetPoseRequest(message))
        if not answer.success:
            require_clear_line(answer.message)

    return message, lambda: node.use(set_pose)


def _image(node: _Camera, random: Random) -> Case:
    message = wrong(random, node.image())
    return message, lambda: node.use(lambda: node.process(message))


def _camera_info(node: _Camera, random: Random) -> Case:
    message = wrong(random, node.camera_info())

    def hear() -> None:
        node.world.callbacks["camera_info"](message)
        node.process(node.image())

    return message, lambda: node.use(hear)


def _exposure(node: _Camera, random: Random) -> Case:
    message = wrong(random, Exposure(Header(stamp=ros_time(stamp_ns(node.index + 1))), 5.0))
    return message, lambda: node.hear("exposure", message)


def _prediction(node: _Camera, random: Random) -> Case:
    motion = MotionPrediction(header=Header(stamp=ros_time(stamp_ns(node.index + 1)), frame_id="vo"))
    motion.start, motion.motion = ros_time(stamp_ns(node.index)), pose_from_matrix(np.eye(4))
    motion.covariance = (1e-6 * np.eye(6)).ravel().tolist()
    message = wrong(random, motion)
    return message, lambda: node.hear("fusion/motion_prediction", message)


def _parameters(patch: pytest.MonkeyPatch) -> Callable[[Random], Case]:
    robot = {"robot": {**ROBOT, "T_base_camera": MOUNT}}
    nodes: Dict[str, Any] = {
        "dso_node": ((DsoParameters, OdometryConfig), {}),
        "fusion_node": ((FusionParameters, FusionConfig), robot),
        "wheel_odometry_node": ((WheelParameters,), robot),
    }
    World(patch)

    def make(random: Random) -> Case:
        name = random.choice(list(nodes))
        kinds, groups = nodes[name]
        given = {key: value for kind in kinds for key, value in plain_values(kind()).items()}
        given = mutated_tree(random, {**given, **groups})

        def read() -> object:
            found = parameters.read(*kinds, groups=ROBOT_GROUP if groups else None)
            return found, read_robot() if groups else None

        def act() -> str:
            private: Dict[str, Any] = {str(key): value for key, value in given.items()}
            patch.setattr(rospy, "get_param", lambda key, default=None: parameters_of(private).get(key, default))
            return outcome_of(read)

        return (name, given), act

    return make
