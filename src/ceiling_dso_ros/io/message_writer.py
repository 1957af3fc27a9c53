# SPDX-License-Identifier: BSD-3-Clause
"""Creates the messages of a robot with a camera, for a bag or for topics."""

from abc import ABC, abstractmethod
from typing import Dict, Iterable, Optional, Sequence, Tuple

import numpy as np
from numpy.typing import ArrayLike

from ceiling_dso_ros.io.ros_messages import (
    RosMessage,
    Vector,
    header,
    message,
    pose,
    quaternion,
    transform_stamped,
    vector,
)
from ceiling_dso_ros.io.stamps import parts_of_stamp

ENCODING_OF_DTYPE = {"uint8": "mono8", "uint16": "mono16", "float32": "32FC1"}


class MessageWriter(ABC):
    """Writes messages to topics.

    All stamps are integer nanoseconds: the header's stamp and the time of writing. Poses are (4, 4) transforms
    `T_frame_child`, metres and radians.
    """

    def __init__(self) -> None:
        self._counts: Dict[str, int] = {}

    @abstractmethod
    def write(self, topic: str, stamp_ns: int, content: RosMessage, latched: bool = False) -> None:
        """Write any message of `ros_messages.TYPES`."""

    def image(
        self, topic: str, stamp_ns: int, frame_id: str, image: np.ndarray, encoding: Optional[str] = None
    ) -> None:
        """Write sensor_msgs/Image.

        The image is (H, W) uint8 (mono8), uint16 (mono16) or float32 (32FC1), or (H, W, channels) with the encoding
        given.
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
        baseline_m: float = 0.0,
    ) -> None:
        """Write sensor_msgs/CameraInfo.

        The size is (width, height), K the (3, 3) matrix of the raw image, and distortion the coefficients of
        distortion_model: plumb_bob, rational_polynomial or equidistant. The right camera of a rectified pair lies by
        baseline_m along x of the left one.
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
            P=np.column_stack([K, [0.0 - K[0, 0] * baseline_m, 0.0, 0.0]]).reshape(12),
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
        positions: ArrayLike,
        velocities: ArrayLike = (),
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
        linear: Vector,
        angular: Vector,
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
        time_increment: float = 0.0,
    ) -> None:
        """Write sensor_msgs/LaserScan.

        The (N,) ranges in metres are spread evenly over angle_limits in radians, both ends included; range_limits are
        the smallest and the largest valid range; scan_time from scan to scan and time_increment from ray to ray are in
        seconds, 0 when unknown. The stamp is that of the first ray.
        """
        first, last = angle_limits
        content = message(
            "sensor_msgs/LaserScan",
            header=self._header(topic, stamp_ns, frame_id),
            angle_min=first,
            angle_max=last,
            angle_increment=(last - first) / (len(ranges) - 1),
            time_increment=time_increment,
            scan_time=scan_time,
            range_min=range_limits[0],
            range_max=range_limits[1],
            ranges=np.asarray(ranges, dtype=np.float32),
            intensities=np.zeros(0, np.float32),
        )
        self.write(topic, stamp_ns, content)

    def occupancy_grid(
        self, topic: str, stamp_ns: int, frame_id: str, occupied: np.ndarray, corner: Tuple[float, float], cell_m: float
    ) -> None:
        """Write a latched nav_msgs/OccupancyGrid.

        occupied is (rows, columns) bool, corner the x, y of occupied[0, 0]'s outer corner, cell_m the size of a cell.
        """
        T_frame_corner = np.eye(4)
        T_frame_corner[:2, 3] = corner
        seconds, nanoseconds = parts_of_stamp(stamp_ns)
        info = message(
            "nav_msgs/MapMetaData",
            map_load_time=message("builtin_interfaces/Time", sec=seconds, nanosec=nanoseconds),
            resolution=cell_m,
            width=occupied.shape[1],
            height=occupied.shape[0],
            origin=pose(T_frame_corner),
        )
        content = message(
            "nav_msgs/OccupancyGrid",
            header=self._header(topic, stamp_ns, frame_id),
            info=info,
            data=np.where(occupied, 100, 0).astype(np.int8).reshape(-1),
        )
        self.write(topic, stamp_ns, content, latched=True)

    def imu(
        self,
        topic: str,
        stamp_ns: int,
        frame_id: str,
        angular_velocity: Vector,
        linear_acceleration: Vector,
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

    def tf(self, stamp_ns: int, parent: str, child: str, T_parent_child: np.ndarray) -> None:
        """Write tf2_msgs/TFMessage with one transform on /tf."""
        stamped = [transform_stamped(stamp_ns, parent, child, T_parent_child)]
        self.write("/tf", stamp_ns, message("tf2_msgs/TFMessage", transforms=stamped))

    def tf_static(self, stamp_ns: int, transforms: Iterable[Tuple[str, str, np.ndarray]]) -> None:
        """Write a latched tf2_msgs/TFMessage on /tf_static: (parent, child, T_parent_child (4, 4)) each."""
        stamped = [transform_stamped(stamp_ns, parent, child, T) for parent, child, T in transforms]
        self.write("/tf_static", stamp_ns, message("tf2_msgs/TFMessage", transforms=stamped), latched=True)

    def _header(self, topic: str, stamp_ns: int, frame_id: str) -> RosMessage:
        count = self._counts.get(topic, 0)
        self._counts[topic] = count + 1
        return header(stamp_ns, frame_id, count)


def _flat(matrix: Optional[np.ndarray], size: int) -> np.ndarray:
    return np.zeros(size) if matrix is None else np.asarray(matrix, dtype=np.float64).reshape(size)
