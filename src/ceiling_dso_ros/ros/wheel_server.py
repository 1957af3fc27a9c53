# SPDX-License-Identifier: BSD-3-Clause
"""The server of wheel_odometry_node: dead reckoning from encoders."""

import threading
from typing import Optional

import numpy as np
import rospy
import tf2_ros
from diagnostic_updater import DiagnosticStatusWrapper
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState
from std_msgs.msg import Header, Int32

from ceiling_dso_ros.fusion.wheel import WheelOdometry
from ceiling_dso_ros.fusion.wheel_motion import WheelMotion, WheelStep
from ceiling_dso_ros.io.errors import one_line
from ceiling_dso_ros.io.stamps import format_stamp
from ceiling_dso_ros.io.tick_pairs import TickPairs
from ceiling_dso_ros.io.wheel_joints import WheelJoints
from ceiling_dso_ros.ros import diagnostics, parameters
from ceiling_dso_ros.ros.conversions import UNKNOWN_VARIANCE, ros_time
from ceiling_dso_ros.ros.data_clock import StampKind
from ceiling_dso_ros.ros.node import publishing
from ceiling_dso_ros.ros.node_parameters import WheelParameters
from ceiling_dso_ros.ros.planar_messages import planar_odometry, planar_transform
from ceiling_dso_ros.ros.robot_parameter import ROBOT_GROUP, read_robot
from ceiling_dso_ros.ros.run_clock import RunClock
from ceiling_dso_ros.ros.senders import Senders
from ceiling_dso_ros.ros.services import offer_trigger

QUEUE_SIZE = 200  # samples; every one counts


class WheelServer:
    """Integrates the wheels of a differential drive.

    Subscribes:
        joint_states (sensor_msgs/JointState): wheel angles, rad; with ~input joint_states.
        left/ticks, right/ticks (std_msgs/Int32): counters, which may wrap around; with ~input ticks. They have no
            stamps, so their arrival times are used: prefer joint_states.

    Publishes:
        wheel/odometry (nav_msgs/Odometry): with covariances, for every sample.
        /tf: odom -> base_link, only with ~publish_tf.
        /diagnostics

    Services:
        ~reset (std_srvs/Trigger): the next sample is the origin.

    Parameters (private, read at start): `WheelParameters`; and robot, which must be given, with ticks_per_turn,
        wheel_radius [left, right] in m and wheel_base in m.
    """

    def __init__(self) -> None:
        """Read the parameters and connect.

        Raises:
            InputError: a parameter, or a file that it names, is wrong.
        """
        own: WheelParameters
        (own,) = parameters.read(WheelParameters, groups=ROBOT_GROUP)
        self._odometry = WheelOdometry(read_robot().model, own.wheels)
        self._odom_frame, self._base_frame = own.odom_frame.lstrip("/"), own.base_frame.lstrip("/")
        self._joints, self._senders = WheelJoints(own.left_joint, own.right_joint), Senders()
        self._samples = diagnostics.Stream(own.silence)

        self._lock = threading.Lock()
        self._clock = RunClock()
        self._broadcaster = tf2_ros.TransformBroadcaster() if own.publish_tf else None
        self._publisher = rospy.Publisher("wheel/odometry", Odometry, queue_size=QUEUE_SIZE, tcp_nodelay=True)
        offer_trigger("~reset", self._reset)
        diagnostics.Diagnostics(self._report, "wheels")
        if own.input == "joint_states":
            self._name = rospy.resolve_name("joint_states")
            self._subscribe("joint_states", JointState, self._on_joint_states)
        else:
            self._name = f"{rospy.resolve_name('left/ticks')} and {rospy.resolve_name('right/ticks')}"
            self._pairs = TickPairs[int]()
            for side in ("left", "right"):
                self._subscribe(f"{side}/ticks", Int32, lambda message, side=side: self._on_ticks(side, message))

    def spin(self) -> None:
        """Work until the node is shut down."""
        rospy.spin()

    @staticmethod
    def _subscribe(topic: str, kind: type, callback: object) -> None:
        rospy.Subscriber(topic, kind, callback, queue_size=QUEUE_SIZE, tcp_nodelay=True)

    def _on_joint_states(self, message: JointState) -> None:
        stamp_ns = message.header.stamp.to_nsec()
        with self._lock:
            were_known = bool(self._joints.pairs)
            angles = self._joints.read(stamp_ns, message.name, message.position, message.velocity)
            if self._joints.pairs and not were_known:
                rospy.loginfo("the wheels are %s", ", ".join(map(str, self._joints.pairs)))
            if self._joints.complaint:
                self._complain(self._joints.complaint)
            elif angles is None and (not self._samples.received or self._samples.silent):  # others may share the topic
                wheels = " and ".join(map(str, self._joints.pairs))
                self._samples.complain(self._joints.missing or f"a message without {wheels}; {self._joints.remedy}")
            if angles is not None and stamp_ns == 0:
                self._samples.complain("a message without a stamp")
            elif angles is not None:
                two_nodes = self._senders.complaint(message)
                if two_nodes:
                    self._complain(f"{' and '.join(map(str, self._joints.pairs))}: {two_nodes}")
                inner_ns = self._begin_sample(angles.stamp_ns)
                if inner_ns is not None:
                    self._take_in(self._odometry.add_angles(inner_ns, angles.left, angles.right))

    def _on_ticks(self, side: str, message: Int32) -> None:
        with self._lock:
            counters = self._pairs.add(side, rospy.Time.now().to_nsec(), message.data)
            if counters is None:
                return
            stamp_ns, left, right = counters
            if stamp_ns == 0:
                self._samples.complain("ticks before the clock has started")
                return
            inner_ns = self._begin_sample(stamp_ns)
            if inner_ns is not None:
                self._take_in(self._odometry.add_ticks(inner_ns, left, right))

    def _begin_sample(self, stamp_ns: int) -> Optional[int]:
        """Count a sample, and restart if a bag is played again.

        Returns:
            Its time on the inner clock; None if its stamp is not believed.
        """
        self._samples.heard()
        kind = self._clock.follow(stamp_ns, self._odometry.reset)
        if kind is StampKind.DOUBTED:
            self._samples.complain(f"the stamp {format_stamp(stamp_ns)} is {kind.value}")
            return None
        return self._clock.inner_ns(stamp_ns)

    def _take_in(self, step: Optional[WheelStep]) -> None:
        if self._odometry.message:
            self._complain(self._odometry.message)
        if not self._odometry.heard:
            return
        total, noise = self._odometry.total, self._odometry.noise
        if step is not None:
            along = np.ix_((0, 2), (0, 2))
            covariance = (noise.white(step) + noise.resolution)[along] / step.duration_s**2
            self._publish(total, step.rate[::2], covariance)
        elif total is not None and not self._odometry.message and total.start_ns == total.end_ns:  # the origin
            self._publish(total, np.zeros(2), UNKNOWN_VARIANCE * np.eye(2))

    def _complain(self, complaint: str) -> None:
        self._samples.complain(complaint)
        rospy.logwarn_throttle(5.0, one_line(complaint))

    def _publish(self, total: WheelMotion, twist: np.ndarray, twist_covariance: np.ndarray) -> None:
        """Publish the motion so far and (2,) forward speed and yaw rate with (2, 2) covariance."""
        header = Header(stamp=ros_time(self._clock.stamp_ns(total.end_ns)), frame_id=self._odom_frame)
        covariance = self._odometry.covariance_odom
        odometry = planar_odometry(header, self._base_frame, total.pose, covariance, twist, twist_covariance)
        with publishing():
            self._publisher.publish(odometry)
            if self._broadcaster is not None:
                self._broadcaster.sendTransform(planar_transform(header, self._base_frame, total.pose))

    def _reset(self) -> str:
        with self._lock:
            self._odometry.reset()
        return "the next wheel sample is the origin"

    def _report(self, status: DiagnosticStatusWrapper) -> DiagnosticStatusWrapper:
        status.summary(diagnostics.OK, "integrating")
        self._samples.judge(status, self._name)
        return status
