# SPDX-License-Identifier: BSD-3-Clause
"""The server of simulation_node: a simulated robot that publishes live sensor data."""

import math
from queue import Empty, SimpleQueue
from typing import Callable, List, Union

import rospy
from geometry_msgs.msg import Twist
from std_msgs.msg import String

from ceiling_dso_ros.dso.config import ConfigError
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.image_scaling import parse_image_size
from ceiling_dso_ros.ros import parameters
from ceiling_dso_ros.ros.answers import Answers
from ceiling_dso_ros.ros.node_parameters import SimulationParameters
from ceiling_dso_ros.ros.topic_writer import SimulatedClock, TopicWriter
from ceiling_dso_ros.simulation.bag import MeasurementMessages
from ceiling_dso_ros.simulation.camera import CameraModel
from ceiling_dso_ros.simulation.closed_loop import ClosedLoop
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.driving.commanded import STEP_S
from ceiling_dso_ros.simulation.events import EventError
from ceiling_dso_ros.simulation.sensors.measurements import START_NS, CameraFrame, Measurement, WheelReading, stamp_ns
from ceiling_dso_ros.simulation.simulation import Simulation

WARNING_PERIOD_S = 5.0
TRUE_BASE_FRAME = "ground_truth/base_link"


class SimulationServer:
    """Simulates a robot and publishes its measurements, with the topics of a bag of `simulate`.

    Publishes:
        /clock: the time of the simulation; all nodes must run with /use_sim_time.
        camera/up/image_raw, camera/up/camera_info, camera/up/exposure, joint_states, wheel/left/ticks,
        wheel/right/ticks, odom, scan, ground_truth, /tf_static: as in a bag of `simulate`.
        /tf: map -> ground_truth/base_link, the true pose.
        map (nav_msgs/OccupancyGrid): what stands in the hall, latched.

    Subscribes, with ~drive cmd_vel:
        cmd_vel (geometry_msgs/Twist): how the robot drives; it stops half a second after the last one.
        ~event (std_msgs/String): something that happens, NAME[@START][+DURATION]; now without a start.

    Parameters (private, read at start): `SimulationParameters`.
    """

    def __init__(self) -> None:
        """Read the parameters and plan the drive.

        Raises:
            InputError: a parameter is wrong.
        """
        self._parameters: SimulationParameters
        (self._parameters,) = parameters.read(SimulationParameters)
        try:
            config = _config(self._parameters)
            self._simulation: Union[ClosedLoop, Simulation] = (
                ClosedLoop(config) if self._parameters.drive == "cmd_vel" else Simulation(config)
            )
        except (ConfigError, EventError) as error:
            raise InputError(f"{rospy.get_name()}: {error}") from error
        self._inbox: SimpleQueue[Callable[[], None]] = SimpleQueue()  # what messages do, at the next step

    def spin(self) -> None:
        """Drive until the drive or the node ends."""
        _ = self._simulation.scene  # built before time begins
        self._clock = SimulatedClock(self._parameters.rate)
        self._topics = TopicWriter()
        self._messages = MeasurementMessages(self._topics, self._simulation, self._parameters.map_to_odom)
        self._topics.occupancy_grid("/map", START_NS, "map", *self._simulation.hall.obstacles.floor_map())
        self._answers = [Answers(topic) for topic in _split(self._parameters.wait_for)]
        try:
            if isinstance(self._simulation, ClosedLoop):
                self._drive(self._simulation)
            else:
                self._play(self._simulation)
        except rospy.ROSInterruptException:
            return
        rospy.loginfo("the drive is over")

    def _play(self, simulation: Simulation) -> None:
        """Drive as planned."""
        for measurement in simulation.measurements():
            self._clock.advance(measurement.stamp_ns)
            self._publish(measurement)

    def _drive(self, simulation: ClosedLoop) -> None:
        """Drive as commanded."""
        rospy.Subscriber("cmd_vel", Twist, self._on_command, callback_args=simulation, queue_size=1, tcp_nodelay=True)
        rospy.Subscriber("~event", String, self._on_event, callback_args=simulation, queue_size=10)
        while simulation.now_s < simulation.duration_s:
            self._clock.advance(stamp_ns(simulation.now_s + STEP_S))
            self._read_inbox()
            for measurement in simulation.step():
                self._publish(measurement)

    def _publish(self, measurement: Measurement) -> None:
        if isinstance(measurement, CameraFrame):
            for answers in self._answers:
                answers.wait()
                answers.ask(measurement.stamp_ns)
        self._messages.write(measurement)
        if isinstance(measurement, WheelReading):
            self._topics.tf(measurement.stamp_ns, "map", TRUE_BASE_FRAME, measurement.T_world_base)

    def _read_inbox(self) -> None:
        while True:
            try:
                self._inbox.get_nowait()()
            except Empty:
                return

    def _on_command(self, message: Twist, simulation: ClosedLoop) -> None:
        speed_m_s, yaw_rate_rad_s = message.linear.x, message.angular.z
        if math.isfinite(speed_m_s) and math.isfinite(yaw_rate_rad_s):
            self._inbox.put(lambda: simulation.command(speed_m_s, yaw_rate_rad_s))
        else:
            rospy.logwarn_throttle(WARNING_PERIOD_S, f"a command is not used: {speed_m_s} m/s, {yaw_rate_rad_s} rad/s")

    def _on_event(self, message: String, simulation: ClosedLoop) -> None:
        def happen() -> None:
            try:
                event = simulation.add_event(message.data)
            except EventError as error:
                rospy.logwarn(str(error))
            else:
                rospy.loginfo(f"{event.kind} from {event.start_s:.2f} s for {event.duration_s:g} s")

        self._inbox.put(happen)


def _config(own: SimulationParameters) -> SimulationConfig:
    """The settings of the simulation.

    Raises:
        InputError: the camera's size is none.
    """
    width, height = parse_image_size(own.camera_size, "camera_size")
    return SimulationConfig(
        sequence=own.sequence,
        ceiling=own.ceiling,
        seed=own.seed,
        duration_s=own.duration,
        camera=CameraModel(width=width, height=height, fps=own.camera_rate),
        stereo=own.stereo,
        events=tuple(_split(own.events)),
    )


def _split(text: str) -> List[str]:
    return [part.strip() for part in text.split(",") if part.strip()]
