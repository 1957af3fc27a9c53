# SPDX-License-Identifier: BSD-3-Clause
"""A simulated drive as a ROS 1 bag, with the truth in files beside it."""

from functools import singledispatchmethod
from pathlib import Path
from typing import Any, Callable, Dict, Iterable

import numpy as np
import yaml

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.config import RobotModel, WheelConfig
from ceiling_dso_ros.fusion.wheel import WheelOdometry
from ceiling_dso_ros.io.message_writer import MessageWriter
from ceiling_dso_ros.io.replacing import replace_file, write_each
from ceiling_dso_ros.io.robot_file import robot_values
from ceiling_dso_ros.io.trajectory import write_tum
from ceiling_dso_ros.simulation.recording import SimulatedRecording
from ceiling_dso_ros.simulation.sensors.laser import SCAN_HZ, SCAN_RANGE_M
from ceiling_dso_ros.simulation.sensors.measurements import (
    START_NS,
    CameraFrame,
    ImuReading,
    Measurement,
    ScanReading,
    WheelReading,
)
from ceiling_dso_ros.simulation.world import World

WHEEL_JOINTS = ("left_wheel_joint", "right_wheel_joint")
CAMERA_NAMESPACES = {
    "camera_up_optical_frame": "/camera/up",
    "camera_up_right_optical_frame": "/camera/up_right",
    "camera_front_optical_frame": "/camera/front",
}


def files_beside(bag: Path) -> Dict[str, Path]:
    """Paths of the files beside a bag: true poses of camera and base, all true values, nominal robot."""
    endings = {
        "camera": ".groundtruth.tum",
        "base": ".groundtruth_base.tum",
        "truth": ".truth.yaml",
        "robot": ".robot.yaml",
    }
    return {name: bag.with_name(bag.stem + ending) for name, ending in endings.items()}


def write_files_beside(bag: Path, recording: SimulatedRecording) -> None:
    """Write the truth.

    Raises:
        OutputError: some files cannot be written; the others are.
    """
    files = files_beside(bag)
    writers: Dict[str, Callable[[Path], None]] = {
        "camera": lambda path: write_tum(path, recording.camera_truth),
        "base": lambda path: write_tum(path, recording.base_truth),
        "truth": lambda path: _write_yaml(path, recording.simulation.truth()),
        "robot": lambda path: _write_yaml(path, robot_values(recording.robot)),
    }
    write_each(bag.parent, {files[kind].name: write for kind, write in writers.items()})


def write_measurements(bag: MessageWriter, recording: SimulatedRecording, measurements: Iterable[Any]) -> None:
    """Write the static transforms and then all measurements, one by one.

    Raises:
        OutputError: the bag cannot be written.
    """
    messages = MeasurementMessages(bag, recording.simulation)
    for measurement in measurements:
        messages.write(measurement)


class MeasurementMessages:
    """Writes each kind of measurement to its topics, and the static transforms at once.

    Args:
        bag: to write to.
        world: what is measured.
        with_map: map -> odom is among the static transforms.
    """

    def __init__(self, bag: MessageWriter, world: World, with_map: bool = True) -> None:
        nominal = world.nominal
        model = RobotModel(nominal.T_base_camera, nominal.wheel_base_m, nominal.wheel_radius_m, nominal.ticks_per_turn)
        self._bag = bag
        self._lens, self._laser = world.config.camera.told_lens, world.config.laser
        self._odometry = WheelOdometry(model, WheelConfig())
        mounts = world.robot.static_transforms()
        fitted = {*world.cameras, "laser", *(("imu",) if world.config.imu else ())}
        transforms = [("base_link", child, T) for child, T in mounts.items() if child in fitted]
        if with_map:  # odom starts at the robot's first pose, so rviz can show a run and the truth in one fixed frame
            transforms = [("map", "odom", planar.lift(world.robot.motion.poses(np.zeros(1))[0])), *transforms]
        bag.tf_static(START_NS, transforms)

    @singledispatchmethod
    def write(self, measurement: Measurement) -> None:
        """Write one measurement.

        Raises:
            OutputError: the bag cannot be written.
        """
        raise TypeError(type(measurement).__name__)

    @write.register
    def _(self, frame: CameraFrame) -> None:
        lens, stamp_ns = self._lens, frame.stamp_ns
        distortion = (*lens.distortion, 0.0) if lens.distortion else (0.0,) * 5
        for frame_id, image in frame.images.items():
            topic = CAMERA_NAMESPACES[frame_id]
            size = (lens.width, lens.height)
            self._bag.camera_info(f"{topic}/camera_info", stamp_ns, frame_id, size, lens.matrix, distortion)
            if frame.exposure_ms is not None:
                self._bag.exposure(f"{topic}/exposure", stamp_ns, frame_id, frame.exposure_ms)
            self._bag.image(f"{topic}/image_raw", stamp_ns, frame_id, image)

    @write.register
    def _(self, reading: WheelReading) -> None:
        stamp_ns, (left, right) = reading.stamp_ns, (int(counter) for counter in reading.counters)
        self._bag.joint_state("/joint_states", stamp_ns, WHEEL_JOINTS, reading.angles_rad)
        self._bag.ticks("/wheel/left/ticks", stamp_ns, left)
        self._bag.ticks("/wheel/right/ticks", stamp_ns, right)
        step = self._odometry.add_ticks(stamp_ns, left, right)
        forward, _, turn = np.zeros(3) if step is None else step.rate
        self._bag.odometry(
            "/odom",
            stamp_ns,
            "odom",
            "base_link",
            planar.lift(self._odometry.total.pose),
            (forward, 0.0, 0.0),
            (0.0, 0.0, turn),
            _planar_covariance(self._odometry.covariance_odom),
        )
        self._bag.pose("/ground_truth", stamp_ns, "map", reading.T_world_base)

    @write.register
    def _(self, reading: ScanReading) -> None:
        angles = self._laser.angles
        limits = (float(angles[0]), float(angles[-1]))
        self._bag.laser_scan(
            "/scan",
            reading.stamp_ns,
            "laser",
            reading.ranges_m,
            limits,
            SCAN_RANGE_M,
            1.0 / SCAN_HZ,
            self._laser.time_increment_s,
        )

    @write.register
    def _(self, reading: ImuReading) -> None:
        self._bag.imu("/imu", reading.stamp_ns, "imu", reading.angular_rate, reading.specific_force)


UNKNOWN_VARIANCE = 1e-6  # of z, roll and pitch, which the floor determines


def _planar_covariance(covariance: np.ndarray) -> np.ndarray:
    """(6, 6) of x y z roll pitch yaw from (3, 3) of x y yaw."""
    full = np.eye(6) * UNKNOWN_VARIANCE
    full[np.ix_([0, 1, 5], [0, 1, 5])] = covariance
    return full


def _write_yaml(path: Path, content: Dict[str, Any]) -> None:
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=120)
    replace_file(path, text.encode(), "the file")
