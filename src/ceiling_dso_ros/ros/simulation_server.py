# SPDX-License-Identifier: BSD-3-Clause
"""The server of simulation_node: a simulated robot that publishes live sensor data."""

import time
from typing import Dict

import rospy
from rosgraph_msgs.msg import Clock
from roslib.message import get_message_class

from ceiling_dso_ros.dso.config import ConfigError
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.message_writer import MessageWriter
from ceiling_dso_ros.io.ros_messages import TYPES, RosMessage
from ceiling_dso_ros.ros import parameters
from ceiling_dso_ros.ros.node_parameters import SimulationParameters
from ceiling_dso_ros.simulation.bag import write_measurements
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.events import EventError
from ceiling_dso_ros.simulation.recording import SimulatedRecording

QUEUE_SIZE = 50


class SimulationServer:
    """Simulates a robot and publishes its measurements, with the topics of a bag of `simulate`.

    Publishes:
        /clock: the time of the simulation; all nodes must run with /use_sim_time.
        camera/up/image_raw, camera/up/camera_info, camera/up/exposure, joint_states, wheel/left/ticks,
        wheel/right/ticks, odom, scan, ground_truth, /tf_static: as in a bag of `simulate`.

    Parameters (private, read at start): `SimulationParameters`.
    """

    def __init__(self) -> None:
        """Read the parameters and plan the drive.

        Raises:
            InputError: a parameter is wrong.
        """
        own: SimulationParameters
        (own,) = parameters.read(SimulationParameters)
        events = [event.strip() for event in own.events.split(",") if event.strip()]
        try:
            config = SimulationConfig(
                sequence=own.sequence,
                ceiling=own.ceiling,
                seed=own.seed,
                duration_s=own.duration,
                events=tuple(events),
            )
            self._recording = SimulatedRecording(config)
        except (ConfigError, EventError) as error:
            raise InputError(f"{rospy.get_name()}: {error}") from error
        self._rate = own.rate

    def spin(self) -> None:
        """Drive until the sequence or the node ends."""
        _ = self._recording.simulation.scene  # built before time begins
        topics = TopicWriter(self._rate)
        try:
            write_measurements(topics, self._recording, self._recording.simulation.measurements())
        except rospy.ROSInterruptException:
            return
        rospy.loginfo("the drive is over")


class TopicWriter(MessageWriter):
    """Publishes messages at their stamps, and /clock.

    Args:
        rate: seconds of stamps per real second.
    """

    def __init__(self, rate: float) -> None:
        super().__init__()
        self._rate = rate
        self._clock = rospy.Publisher("/clock", Clock, queue_size=10)
        self._publishers: Dict[str, rospy.Publisher] = {}
        self._start_s = time.monotonic()
        self._start_ns = 0

    def write(self, topic: str, stamp_ns: int, content: RosMessage, latched: bool = False) -> None:
        """See MessageWriter.

        Raises:
            rospy.ROSInterruptException: the node is shut down.
        """
        self._wait(stamp_ns)
        package, _, name = content.__msgtype__.split("/")
        kind = get_message_class(f"{package}/{name}")
        topic = topic if topic.startswith("/tf") else topic.lstrip("/")  # within the namespace of the node
        if topic not in self._publishers:
            self._publishers[topic] = rospy.Publisher(topic, kind, queue_size=QUEUE_SIZE, latch=latched)
        message = kind().deserialize(bytes(TYPES.serialize_ros1(content, content.__msgtype__)))
        self._publishers[topic].publish(message)

    def _wait(self, stamp_ns: int) -> None:
        """Wait for the time of a stamp; if it is already over, later stamps are delayed by the same time."""
        if rospy.is_shutdown():
            raise rospy.ROSInterruptException
        self._start_ns = self._start_ns or stamp_ns
        due_s = self._start_s + 1e-9 * (stamp_ns - self._start_ns) / self._rate
        ahead_s = due_s - time.monotonic()
        if ahead_s > 0.0:
            time.sleep(ahead_s)
        else:
            self._start_s -= ahead_s
        self._clock.publish(Clock(rospy.Time(0, stamp_ns)))
