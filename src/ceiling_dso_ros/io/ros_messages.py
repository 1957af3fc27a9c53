# SPDX-License-Identifier: BSD-3-Clause
"""ROS 1 messages without ROS: their types and common parts."""

from typing import Any, Dict, Sequence, Tuple, Union

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.io import realsense_metadata
from ceiling_dso_ros.io.limits import LARGEST_M
from ceiling_dso_ros.io.stamps import parts_of_stamp, stamp_from_parts

RosMessage = Any  # the classes of the type store have no common base
Vector = Union[Sequence[float], np.ndarray]  # (3,)

# Not part of the noetic type store of rosbags. Exposure is msg/Exposure.msg of this package.
EXTRA_DEFINITIONS = {
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "ceiling_dso_ros/msg/Exposure": "std_msgs/Header header\nfloat64 exposure_ms",
    realsense_metadata.TYPE: realsense_metadata.DEFINITION,
}


def _noetic_types() -> Typestore:
    types = get_typestore(Stores.ROS1_NOETIC)
    for name, definition in EXTRA_DEFINITIONS.items():
        types.register(get_types_from_msg(definition, name))
    return types


TYPES = _noetic_types()


def message(type_name: str, **fields: object) -> RosMessage:
    """A message of a type such as `sensor_msgs/Image`; all fields must be given."""
    package, name = type_name.split("/")
    return TYPES.types[f"{package}/msg/{name}"](**fields)


def header(stamp_ns: int, frame_id: str, seq: int = 0) -> RosMessage:
    """std_msgs/Header."""
    sec, nanosec = parts_of_stamp(stamp_ns)
    stamp = TYPES.types["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
    return message("std_msgs/Header", seq=seq, stamp=stamp, frame_id=frame_id)


def header_stamp_ns(header: RosMessage) -> int:
    """Nanoseconds of a std_msgs/Header; seconds are unsigned in ROS 1, and rosbags reads them as signed."""
    return stamp_from_parts(header.stamp.sec % 2**32, header.stamp.nanosec)


def vector(xyz: Vector) -> RosMessage:
    """geometry_msgs/Vector3 of (3,) numbers."""
    return message("geometry_msgs/Vector3", **_xyz(xyz))


def pose(T_frame_body: np.ndarray) -> RosMessage:
    """geometry_msgs/Pose of a (4, 4) transform."""
    return message(
        "geometry_msgs/Pose",
        position=message("geometry_msgs/Point", **_xyz(T_frame_body[:3, 3])),
        orientation=quaternion(T_frame_body),
    )


def transform_stamped(stamp_ns: int, parent: str, child: str, T_parent_child: np.ndarray) -> RosMessage:
    """geometry_msgs/TransformStamped: the pose of child in parent, (4, 4)."""
    return message(
        "geometry_msgs/TransformStamped",
        header=header(stamp_ns, parent),
        child_frame_id=child,
        transform=message(
            "geometry_msgs/Transform", translation=vector(T_parent_child[:3, 3]), rotation=quaternion(T_parent_child)
        ),
    )


def quaternion(T: np.ndarray) -> RosMessage:
    """geometry_msgs/Quaternion of the rotation of a (4, 4) transform."""
    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat().tolist()
    return message("geometry_msgs/Quaternion", x=x, y=y, z=z, w=w)


def pose_matrix(position: RosMessage, orientation: RosMessage) -> np.ndarray:
    """(4, 4) transform of a geometry_msgs/Point or Vector3 and a Quaternion, of rosbags or of rospy.

    Raises:
        ValueError: a number is not finite or beyond all bounds, or the quaternion is zero.
    """
    numbers = np.array([position.x, position.y, position.z, orientation.x, orientation.y, orientation.z, orientation.w])
    if not np.isfinite(numbers).all():
        raise ValueError("the pose has a number that is not finite")
    if np.abs(numbers).max() > LARGEST_M:
        raise ValueError(f"the pose has a number beyond {LARGEST_M:g}")
    if np.linalg.norm(numbers[3:]) < 1e-6:
        raise ValueError("the pose's quaternion is zero")
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat(numbers[3:]).as_matrix()
    T[:3, 3] = numbers[:3]
    return T


def planar_pose(pose: RosMessage) -> np.ndarray:
    """(3,) x, y, yaw of a geometry_msgs/Pose, of rosbags or of rospy; z, roll and pitch are left out.

    Raises:
        ValueError: as `pose_matrix`.
    """
    T = pose_matrix(pose.position, pose.orientation)
    return np.array([T[0, 3], T[1, 3], np.arctan2(T[1, 0], T[0, 0])])


def transform_matrix(transform: RosMessage) -> Tuple[str, str, np.ndarray]:
    """Parent, child and T_parent_child (4, 4) of a geometry_msgs/TransformStamped.

    Raises:
        ValueError: as `pose_matrix`.
    """
    T_parent_child = pose_matrix(transform.transform.translation, transform.transform.rotation)
    return transform.header.frame_id.lstrip("/"), transform.child_frame_id.lstrip("/"), T_parent_child


def _xyz(values: Vector) -> Dict[str, float]:
    x, y, z = (float(value) for value in values)
    return {"x": x, "y": y, "z": z}
