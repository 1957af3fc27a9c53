# SPDX-License-Identifier: BSD-3-Clause
"""A robot that drives a circle in real time, with a visual odometry that errs nowhere; for rostests of the fusion."""

import threading
import time
from contextlib import suppress
from xmlrpc.client import ServerProxy

import numpy as np
import rosgraph
import rospy
import tf2_ros
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Pose, TransformStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage
from waiting import SOON_S, wait_until

from ceiling_dso_ros.dso.mapping.map_snapshot import MapPoints
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.io.ros_messages import planar_pose
from ceiling_dso_ros.msg import FusionScale, FusionStatus, Keyframe, Keyframes, RelativePose, VisualOdometryStatus
from ceiling_dso_ros.ros.conversions import pose_from_matrix, ros_time
from ceiling_dso_ros.ros.map_publisher import point_cloud

WHEEL_HZ, CAMERA_HZ, FRAMES_PER_KEYFRAME = 50, 25, 5
SPEED_M_S, TURN_RAD_S = 0.5, 0.25
RADIUS_M, BASE_M = 0.1, 0.5  # as in fake_robot.yaml
SCALE_M = 4.0  # of the visual odometry's unit
LASER_XYZ = np.array([0.28, 0.0, 0.2])  # in base_link; the camera sits in its origin and looks up
TIMEOUT_S = 60.0


class FakeRobot:
    """Publishes while the context lasts; what it publishes can be switched off and set back in time.

    Attributes:
        wheels, camera: whether they are published.
        keyframes: whether further keyframes are made.
        shift_ns: what is added to all stamps.
    """

    def __init__(self):
        self.wheels = self.camera = self.keyframes = True
        self.shift_ns = 0
        self._joints = rospy.Publisher("joint_states", JointState, queue_size=100)
        self._status = rospy.Publisher("visual_odometry/status", VisualOdometryStatus, queue_size=100)
        self._keyframes = rospy.Publisher("visual_odometry/keyframes", Keyframes, queue_size=100, latch=True)
        self._points = rospy.Publisher("visual_odometry/points", PointCloud2, queue_size=10)
        self._mounts = tf2_ros.StaticTransformBroadcaster()
        self._mounts.sendTransform([mount("camera", np.zeros(3)), mount("laser", LASER_XYZ)])
        self._begin_ns = rospy.Time.now().to_nsec()
        self._window, self._reference = [], None
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._drive, daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._end.set()
        self._thread.join()

    def pose(self, time_s):
        """True (3,) pose of base_link at a time, seen from where it began."""
        return planar.expmap(np.array([SPEED_M_S, 0.0, TURN_RAD_S]) * (time_s - self._begin_ns * 1e-9))

    def now_s(self):
        """What the robot would stamp now."""
        return rospy.get_time() + self.shift_ns * 1e-9

    def joint_state(self, left_rad, right_rad, names=("left_wheel", "right_wheel")):
        """Publish any wheel angles, with the stamp of now."""
        self._joints.publish(
            JointState(Header(stamp=self._stamp(rospy.Time.now().to_nsec())), names, [left_rad, right_rad], [], [])
        )

    def publish_window_of_another_run(self):
        """Latch a window with later keyframes and later stamps."""
        header = Header(stamp=self._stamp(rospy.Time.now().to_nsec() + 1000 * 10**9), frame_id="vo")
        self._keyframes.publish(
            Keyframes(header, [Keyframe(id=300, stamp=header.stamp, pose=pose_from_matrix(np.eye(4)))])
        )

    def _stamp(self, time_ns):
        return ros_time(time_ns + self.shift_ns)

    def _drive(self):
        for tick in range(10**9):
            driven_s = tick / WHEEL_HZ
            due_ns = self._begin_ns + tick * (10**9 // WHEEL_HZ)
            if self._end.wait(max(0.0, due_ns * 1e-9 - rospy.get_time())):
                return
            if self.wheels:
                way, turn = SPEED_M_S * driven_s, 0.5 * BASE_M * TURN_RAD_S * driven_s
                angles = [(way - turn) / RADIUS_M, (way + turn) / RADIUS_M]
                joints = JointState(Header(stamp=self._stamp(due_ns)), ["left_wheel", "right_wheel"], angles, [], [])
                self._joints.publish(joints)
            if self.camera and tick % (WHEEL_HZ // CAMERA_HZ) == 0:
                self._see(tick // (WHEEL_HZ // CAMERA_HZ), due_ns)

    def _see(self, frame, due_ns):
        """Status and keyframes of an image."""
        T = planar.lift(self.pose(due_ns * 1e-9))
        T[:3, 3] /= SCALE_M
        header = Header(stamp=self._stamp(due_ns), frame_id="vo")
        is_keyframe = frame % FRAMES_PER_KEYFRAME == 0 and (self.keyframes or self._reference is None)
        if is_keyframe:
            self._reference = (frame // FRAMES_PER_KEYFRAME, T)
            keyframe = Keyframe(id=self._reference[0], stamp=header.stamp, pose=pose_from_matrix(T))
            self._window = [*self._window, keyframe][-7:]
            self._keyframes.publish(Keyframes(header, self._window))
            lamp = T[:3, 3] + [0.0, 0.0, 1.0]  # always straight above the robot
            self._points.publish(point_cloud(header, MapPoints(lamp[None], np.array([255.0]))))
        if self._reference is not None:
            self._status.publish(
                VisualOdometryStatus(
                    header=header,
                    state=VisualOdometryStatus.TRACKING,
                    is_keyframe=is_keyframe,
                    pose=[self._relative(T)],
                    keyframes=self._window if is_keyframe else [],
                    camera_frame_id="camera",
                )
            )

    def _relative(self, T):
        keyframe_id, T_keyframe = self._reference
        return RelativePose(keyframe_id=keyframe_id, pose=pose_from_matrix(np.linalg.inv(T_keyframe) @ T))


class Listener:
    """Everything that the fusion says."""

    def __init__(self):
        self.poses, self.statuses, self.scales, self.wheel_poses = [], [], [], []
        self.arrivals_s = []
        self.diagnostics = {}  # name of a node -> DiagnosticStatus
        self.buffer = tf2_ros.Buffer()
        self._tf = tf2_ros.TransformListener(self.buffer)
        self._subscribers = [
            rospy.Subscriber("odometry/filtered", Odometry, self._on_pose, queue_size=1000, tcp_nodelay=True),
            rospy.Subscriber("fusion/status", FusionStatus, self.statuses.append, queue_size=1000),
            rospy.Subscriber("fusion/scale", FusionScale, self.scales.append, queue_size=1000),
            rospy.Subscriber("wheel/odometry", Odometry, self.wheel_poses.append, queue_size=1000),
            rospy.Subscriber("/diagnostics", DiagnosticArray, self._on_diagnostics, queue_size=100),
        ]

    def level(self, node):
        """Level of a node's diagnostics, -1 when there are none."""
        return self.diagnostics[node].level if node in self.diagnostics else -1

    def wait_for_level(self, node, level):
        """Wait until a node's diagnostics have a level; returns the seconds it took."""
        start_s = time.monotonic()
        wait_until(lambda: self.level(node) == level, lambda: f"{node}: {self.diagnostics.get(node)}, wanted {level}")
        return time.monotonic() - start_s

    def transform(self, parent, child, stamp):
        """geometry_msgs/TransformStamped of a time, which may still have to come."""
        return self.buffer.lookup_transform(parent, child, stamp, rospy.Duration(SOON_S))

    def wait_for_poses(self, count):
        """Wait for that many more poses."""
        wanted = len(self.poses) + count
        wait_until(lambda: len(self.poses) >= wanted, "the poses have stopped")

    def wait_for_scale(self, robot):
        """Wait until the scale is known of a sample that is still to come: others may be of before a reset."""
        start_s = robot.now_s()

        def is_known():
            newest = self.scales[-1:]
            return any(s.converged and start_s < s.header.stamp.to_sec() <= robot.now_s() for s in newest)

        wait_until(is_known, "the scale is not found")

    def wait_for_jump(self, messages, first, xy, reach_m):
        """Wait until one of the nav_msgs/Odometry of 4 s since the first is near a place too far away to drive to."""
        wait_until(
            lambda: any(np.linalg.norm(xy_yaw(m)[:2] - xy) < reach_m for m in messages[first : first + 4 * WHEEL_HZ]),
            f"nothing comes from {xy}",
        )

    def _on_pose(self, message):
        self.arrivals_s.append(rospy.get_time())
        self.poses.append(message)

    def _on_diagnostics(self, message):
        for status in message.status:
            self.diagnostics[status.name.split(":")[0].strip().rpartition("/")[2]] = status


def xy_yaw(message):
    """(3,) of a nav_msgs/Odometry."""
    return planar_pose(message.pose.pose)


def mount(frame, xyz):
    """geometry_msgs/TransformStamped base_link -> frame."""
    transform = TransformStamped(header=Header(frame_id="base_link"), child_frame_id=frame)
    transform.transform.translation.x, transform.transform.translation.y, transform.transform.translation.z = xyz
    transform.transform.rotation.w = 1.0
    return transform


def node_at(name):
    """The API of a running node."""
    return ServerProxy(rosgraph.Master(rospy.get_name()).lookupNode(name))


def pid_of(name):
    """The process of a running node."""
    return node_at(name).getPid(rospy.get_name())[2]


def end_node(name):
    """Ask a node to end, as `rosnode kill` does."""
    node = node_at(name)
    with suppress(ConnectionError):  # it may end before it has answered
        node.shutdown(rospy.get_name(), "test")


def any_pose(x, y, yaw):
    """geometry_msgs/Pose."""
    return pose_from_matrix(planar.lift(np.array([x, y, yaw]))) if np.isfinite([x, y, yaw]).all() else Pose()


def parents(frame, seconds=1.0):
    """(parent, publishing node) of all transforms of a frame that are sent for a while."""
    found = set()

    def note(message):
        sender = message._connection_header["callerid"]
        found.update((t.header.frame_id, sender) for t in message.transforms if t.child_frame_id == frame)

    subscriber = rospy.Subscriber("/tf", TFMessage, note, queue_size=100)
    time.sleep(seconds)
    subscriber.unregister()
    return found
