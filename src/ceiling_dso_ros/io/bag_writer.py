"""Writes ROS 1 bags message by message, as `rosbag record` would."""

import os
import struct
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Dict, Iterable, Optional, Sequence, Tuple, Type, Union

import numpy as np
from rosbags.interfaces import Connection
from rosbags.rosbag1 import Writer

from ceiling_dso_ros.io.errors import OutputError
from ceiling_dso_ros.io.interrupts import deferred_interrupt
from ceiling_dso_ros.io.ros_messages import (
    TYPES,
    RosMessage,
    header,
    message,
    pose,
    quaternion,
    transform_stamped,
    vector,
)

HEADER_GAP = 8  # bytes, see _lengthen_bag_header
ENCODING_OF_DTYPE = {"uint8": "mono8", "uint16": "mono16"}


class BagWriter:
    """A ROS 1 bag that grows with every call; a context manager.

    Like `rosbag record` it writes to `<path>.active` and renames that when it is closed, also after an exception or
    Ctrl-C: what has its final name is whole and indexed. A bag that was there before is replaced.

    All stamps are integer nanoseconds: the header's stamp and the time of the record in the bag. Poses are (4, 4)
    transforms `T_frame_child`, metres and radians.

    Raises:
        OutputError: the file cannot be written, from the constructor or any method.
    """

    def __init__(self, path: Union[str, Path]) -> None:
        self.path = Path(path)
        self._active = self.path.with_name(self.path.name + ".active")
        self._connections: Dict[str, Connection] = {}
        self._counts: Dict[str, int] = {}
        try:
            self._active.unlink(missing_ok=True)
            self._writer = Writer(self._active)
            self._writer.open()
            self._writer.bio.write(b" " * HEADER_GAP)
            self._writer.bio.flush()
            _lengthen_bag_header(self._active)
        except OSError as error:
            raise OutputError(f"{self.path}: cannot write the bag: {error.strerror}") from error

    def __enter__(self) -> "BagWriter":
        return self

    def __exit__(
        self, kind: Optional[Type[BaseException]], error: Optional[BaseException], trace: Optional[TracebackType]
    ) -> None:
        if self._writer.bio.closed:  # abandoned
            return
        try:
            with deferred_interrupt():
                self._writer.close()
                _lengthen_bag_header(self._active)
                self._active.replace(self.path)
        except OSError as failure:
            self._abandon(failure)

    def write(self, topic: str, stamp_ns: int, content: RosMessage, latched: bool = False) -> None:
        """Write any message of `ros_messages.TYPES`."""
        try:
            connection = self._connections.get(topic)
            if connection is None:
                connection = self._writer.add_connection(
                    topic, content.__msgtype__, typestore=TYPES, latching=1 if latched else None
                )
                self._connections[topic] = connection
            self._counts[topic] = self._counts.get(topic, 0) + 1
            data = TYPES.serialize_ros1(content, content.__msgtype__)
            with deferred_interrupt():
                self._writer.write(connection, stamp_ns, data)
        except OSError as error:
            self._abandon(error)

    def image(
        self, topic: str, stamp_ns: int, frame_id: str, image: np.ndarray, encoding: Optional[str] = None
    ) -> None:
        """Write sensor_msgs/Image.

        The image is (H, W) uint8 (mono8) or uint16 (mono16), or (H, W, channels) with the encoding given.
        """
        image = np.ascontiguousarray(image)
        fields = {
            "header": self._header(topic, stamp_ns, frame_id),
            "height": image.shape[0],
            "width": image.shape[1],
            "encoding": encoding or ENCODING_OF_DTYPE[image.dtype.name],
            "is_bigendian": 0,
            "step": image.strides[0],
            "data": image.reshape(-1).view(np.uint8),
        }
        self.write(topic, stamp_ns, message("sensor_msgs/Image", **fields))

    def compressed_image(self, topic: str, stamp_ns: int, frame_id: str, data: bytes, image_format: str) -> None:
        """Write sensor_msgs/CompressedImage: data is a whole file of image_format `jpeg` or `png`."""
        content = message(
            "sensor_msgs/CompressedImage",
            header=self._header(topic, stamp_ns, frame_id),
            format=image_format,
            data=np.frombuffer(data, np.uint8),
        )
        self.write(topic, stamp_ns, content)

    def camera_info(
        self,
        topic: str,
        stamp_ns: int,
        frame_id: str,
        size: Tuple[int, int],
        K: np.ndarray,
        distortion: Sequence[float] = (0.0, 0.0, 0.0, 0.0, 0.0),
        distortion_model: str = "plumb_bob",
    ) -> None:
        """Write sensor_msgs/CameraInfo of one unrectified camera.

        The size is (width, height), K the (3, 3) matrix of the raw image, and distortion the coefficients of
        distortion_model: plumb_bob, rational_polynomial or equidistant.
        """
        K = np.asarray(K, dtype=np.float64)
        region = message("sensor_msgs/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
        content = message(
            "sensor_msgs/CameraInfo",
            header=self._header(topic, stamp_ns, frame_id),
            height=size[1],
            width=size[0],
            distortion_model=distortion_model,
            D=np.asarray(distortion, dtype=np.float64),
            K=K.reshape(9),
            R=np.eye(3).reshape(9),
            P=np.hstack([K, np.zeros((3, 1))]).reshape(12),
            binning_x=0,
            binning_y=0,
            roi=region,
        )
        self.write(topic, stamp_ns, content)

    def exposure(self, topic: str, stamp_ns: int, frame_id: str, exposure_ms: float) -> None:
        """Write ceiling_dso_ros/Exposure for the image of the same stamp."""
        exposure = message(
            "ceiling_dso_ros/Exposure", header=self._header(topic, stamp_ns, frame_id), exposure_ms=float(exposure_ms)
        )
        self.write(topic, stamp_ns, exposure)

    def ticks(self, topic: str, stamp_ns: int, value: int) -> None:
        """Write std_msgs/Int32: the raw counter of one wheel, wrapped into 32 bits."""
        wrapped = (int(value) + 2**31) % 2**32 - 2**31
        self.write(topic, stamp_ns, message("std_msgs/Int32", data=wrapped))

    def joint_state(
        self,
        topic: str,
        stamp_ns: int,
        names: Sequence[str],
        positions: Sequence[float],
        velocities: Sequence[float] = (),
    ) -> None:
        """Write sensor_msgs/JointState: wheel angles in radians, rates in radians per second."""
        content = message(
            "sensor_msgs/JointState",
            header=self._header(topic, stamp_ns, ""),
            name=list(names),
            position=np.asarray(positions, dtype=np.float64),
            velocity=np.asarray(velocities, dtype=np.float64),
            effort=np.zeros(0),
        )
        self.write(topic, stamp_ns, content)

    def odometry(
        self,
        topic: str,
        stamp_ns: int,
        frame_id: str,
        child_frame_id: str,
        T_frame_child: np.ndarray,
        linear: Sequence[float],
        angular: Sequence[float],
        pose_covariance: Optional[np.ndarray] = None,
        twist_covariance: Optional[np.ndarray] = None,
    ) -> None:
        """Write nav_msgs/Odometry.

        The velocities, (3,) in m/s and rad/s, are the child's in its own frame. Covariances are (6, 6), translation
        first, zeros when not given.
        """
        twist = message("geometry_msgs/Twist", linear=vector(linear), angular=vector(angular))
        content = message(
            "nav_msgs/Odometry",
            header=self._header(topic, stamp_ns, frame_id),
            child_frame_id=child_frame_id,
            pose=message(
                "geometry_msgs/PoseWithCovariance", pose=pose(T_frame_child), covariance=_flat(pose_covariance, 36)
            ),
            twist=message("geometry_msgs/TwistWithCovariance", twist=twist, covariance=_flat(twist_covariance, 36)),
        )
        self.write(topic, stamp_ns, content)

    def pose(self, topic: str, stamp_ns: int, frame_id: str, T_frame_body: np.ndarray) -> None:
        """Write geometry_msgs/PoseStamped."""
        content = message(
            "geometry_msgs/PoseStamped", header=self._header(topic, stamp_ns, frame_id), pose=pose(T_frame_body)
        )
        self.write(topic, stamp_ns, content)

    def laser_scan(
        self,
        topic: str,
        stamp_ns: int,
        frame_id: str,
        ranges: np.ndarray,
        angle_limits: Tuple[float, float],
        range_limits: Tuple[float, float],
        scan_time: float = 0.0,
    ) -> None:
        """Write sensor_msgs/LaserScan.

        The (N,) ranges in metres are spread evenly over angle_limits in radians, both ends included; range_limits are
        the smallest and the largest valid range; scan_time is in seconds, 0 when unknown.
        """
        first, last = angle_limits
        content = message(
            "sensor_msgs/LaserScan",
            header=self._header(topic, stamp_ns, frame_id),
            angle_min=first,
            angle_max=last,
            angle_increment=(last - first) / (len(ranges) - 1),
            time_increment=0.0,
            scan_time=scan_time,
            range_min=range_limits[0],
            range_max=range_limits[1],
            ranges=np.asarray(ranges, dtype=np.float32),
            intensities=np.zeros(0, np.float32),
        )
        self.write(topic, stamp_ns, content)

    def imu(
        self,
        topic: str,
        stamp_ns: int,
        frame_id: str,
        angular_velocity: Sequence[float],
        linear_acceleration: Sequence[float],
    ) -> None:
        """Write sensor_msgs/Imu: rad/s and m/s^2 in frame_id, no orientation."""
        content = message(
            "sensor_msgs/Imu",
            header=self._header(topic, stamp_ns, frame_id),
            orientation=quaternion(np.eye(4)),
            orientation_covariance=np.array([-1.0] + [0.0] * 8),  # -1: there is no orientation
            angular_velocity=vector(angular_velocity),
            angular_velocity_covariance=np.zeros(9),
            linear_acceleration=vector(linear_acceleration),
            linear_acceleration_covariance=np.zeros(9),
        )
        self.write(topic, stamp_ns, content)

    def tf_static(self, stamp_ns: int, transforms: Iterable[Tuple[str, str, np.ndarray]]) -> None:
        """Write a latched tf2_msgs/TFMessage on /tf_static: (parent, child, T_parent_child (4, 4)) each."""
        stamped = [transform_stamped(stamp_ns, parent, child, T) for parent, child, T in transforms]
        self.write("/tf_static", stamp_ns, message("tf2_msgs/TFMessage", transforms=stamped), latched=True)

    def _header(self, topic: str, stamp_ns: int, frame_id: str) -> RosMessage:
        return header(stamp_ns, frame_id, self._counts.get(topic, 0))

    def _abandon(self, error: OSError) -> None:
        """Remove what was written: without its index it is of no use."""
        with suppress(OSError):  # what is still in the buffer finds no room either
            self._writer.bio.close()
        self._active.unlink(missing_ok=True)
        raise OutputError(f"{self.path}: cannot write the bag, it was removed: {error.strerror}") from error


def _lengthen_bag_header(path: Path) -> None:
    """Give the padding of the bag's first record the length that ROS expects.

    ROS pads header and data to 4096 bytes, rosbags the record with its two length fields. With the shorter record
    `rosbag reindex` would write over the first chunk.
    """
    with path.open("r+b") as file:
        file.seek(len(b"#ROSBAG V2.0\n"))
        (header_length,) = struct.unpack("<L", file.read(4))
        file.seek(header_length, os.SEEK_CUR)
        file.write(struct.pack("<L", 4096 - header_length))


def _flat(matrix: Optional[np.ndarray], size: int) -> np.ndarray:
    return np.zeros(size) if matrix is None else np.asarray(matrix, dtype=np.float64).reshape(size)
