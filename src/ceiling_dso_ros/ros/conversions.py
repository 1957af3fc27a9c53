# SPDX-License-Identifier: BSD-3-Clause
"""ROS messages to arrays and the odometry's values to ROS messages."""

import math
from typing import Sequence, Union

import numpy as np
from genpy import Time
from geometry_msgs.msg import Pose, Transform
from nav_msgs.msg import Odometry
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import Header

from ceiling_dso_ros.dso import KeyframeEstimate, OdometryStatus, TrackingState
from ceiling_dso_ros.io.image_decoding import decode_compressed, decode_image
from ceiling_dso_ros.io.limits import LARGEST_M
from ceiling_dso_ros.io.ros_messages import pose_matrix
from ceiling_dso_ros.msg import Keyframe, RelativePose, VisualOdometryStatus

LATEST_ROS_NS = 2**32 * 10**9 - 1  # a time has 32 bits for its seconds
UNKNOWN_VARIANCE = 9999.0  # by convention: the value is unknown
SMALLEST_VARIANCE = 1e-12  # consumers invert the covariance, so it is never singular

STATES = {
    TrackingState.INITIALIZING: VisualOdometryStatus.INITIALIZING,
    TrackingState.TRACKING: VisualOdometryStatus.TRACKING,
    TrackingState.RETRYING: VisualOdometryStatus.RETRYING,
    TrackingState.LOST: VisualOdometryStatus.LOST,
    TrackingState.RECOVERING: VisualOdometryStatus.RECOVERING,
}


def image_array(message: Union[Image, CompressedImage]) -> np.ndarray:
    """Grey image (height, width), uint8, uint16 or float32.

    Raises:
        FrameError: unknown encoding, or data that do not fit the size.
    """
    if isinstance(message, CompressedImage):
        return decode_compressed(message.data, message.format)
    return decode_image(
        message.encoding, message.height, message.width, message.step, message.is_bigendian, message.data
    )


def covariance_from_message(values: Sequence[float]) -> np.ndarray:
    """(6, 6) of the 36 numbers of a message.

    Raises:
        ValueError: a number is not finite or beyond all bounds.
    """
    covariance = np.reshape(values, (6, 6))
    if not np.isfinite(covariance).all():
        raise ValueError("the covariance of a pose is not finite")
    if np.abs(covariance).max() > LARGEST_M**2:
        raise ValueError(f"the covariance of a pose has a number beyond {LARGEST_M**2:g}")
    return covariance


def pose_from_matrix(T_parent_child: np.ndarray) -> Pose:
    """geometry_msgs/Pose of a (4, 4) transform."""
    pose = Pose()
    pose.position.x, pose.position.y, pose.position.z = T_parent_child[:3, 3].tolist()
    quaternion = Rotation.from_matrix(T_parent_child[:3, :3]).as_quat().tolist()
    pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w = quaternion
    return pose


def matrix_from_pose(pose: Pose) -> np.ndarray:
    """(4, 4) transform of a geometry_msgs/Pose, the inverse of `pose_from_matrix`.

    Raises:
        ValueError: as `pose_matrix`.
    """
    return pose_matrix(pose.position, pose.orientation)


def matrix_from_transform(transform: Transform) -> np.ndarray:
    """(4, 4) of a geometry_msgs/Transform.

    Raises:
        ValueError: as `pose_matrix`.
    """
    return pose_matrix(transform.translation, transform.rotation)


def ros_time(stamp_ns: int) -> Time:
    """The ROS time of a stamp, to the nanosecond; its `to_nsec` gives the stamp back.

    One that ROS has no time for, before 1970 or after 2106, becomes the nearest that it has.
    """
    return Time(0, min(max(stamp_ns, 0), LATEST_ROS_NS))


def pose_covariance(covariance: np.ndarray, T_world_camera: np.ndarray) -> np.ndarray:
    """Covariance as geometry_msgs/PoseWithCovariance means it: of the position and of rotations about fixed axes.

    A left-multiplied increment (v, w) moves the camera at position p by v + w x p, so p enters the position's share.

    Args:
        covariance: (6, 6) of (translation, rotation), left-multiplied on T_world_camera.
        T_world_camera: (4, 4).

    Returns:
        (6, 6) float64 in the world's axes, positive on the diagonal.
    """
    x, y, z = T_world_camera[:3, 3]
    jacobian = np.eye(6)
    jacobian[:3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
    return jacobian @ covariance @ jacobian.T + SMALLEST_VARIANCE * np.eye(6)


def odometry_message(
    header: Header, child_frame_id: str, T_world_camera: np.ndarray, covariance: np.ndarray
) -> Odometry:
    """nav_msgs/Odometry with an unknown twist.

    Args:
        header: stamp of the image and the world frame.
        child_frame_id: the camera's optical frame.
        T_world_camera: (4, 4).
        covariance: (6, 6) as `pose_covariance` gives it.
    """
    message = Odometry(header=header, child_frame_id=child_frame_id)
    message.pose.pose = pose_from_matrix(T_world_camera)
    message.pose.covariance = covariance.ravel().tolist()
    message.twist.covariance = unknown_covariance().ravel().tolist()
    return message


def unknown_covariance() -> np.ndarray:
    """(6, 6) covariance of an unknown pose."""
    return UNKNOWN_VARIANCE * np.eye(6)


def status_message(header: Header, status: OdometryStatus) -> VisualOdometryStatus:
    """VisualOdometryStatus of an image, its counts, times and frame left to the node."""
    relative = status.T_keyframe_camera
    return VisualOdometryStatus(
        header=header,
        state=STATES[status.state],
        message=status.message,
        segment=status.segment,
        pose=[] if relative is None else [_relative_pose(status, relative)],
        is_keyframe=status.is_keyframe,
        keyframes=[_keyframe(keyframe) for keyframe in status.keyframes],
        active_points=status.active_points,
        candidate_points=status.candidate_points,
        rmse=status.rmse,
        predict_from=ros_time(status.predict_from_ns),
    )


def no_pose_message(header: Header, last: VisualOdometryStatus, message: str) -> VisualOdometryStatus:
    """VisualOdometryStatus of an image that was not processed; message says why, the state does not change."""
    return VisualOdometryStatus(
        header=header,
        state=last.state,
        segment=last.segment,
        active_points=last.active_points,
        candidate_points=last.candidate_points,
        message=message,
        rmse=float("nan"),
        predict_from=last.predict_from,
    )


def _relative_pose(status: OdometryStatus, T_keyframe_camera: np.ndarray) -> RelativePose:
    covariance = np.zeros((6, 6)) if status.relative_covariance is None else status.relative_covariance
    return RelativePose(status.keyframe_id, pose_from_matrix(T_keyframe_camera), covariance.ravel().tolist())


def _keyframe(keyframe: KeyframeEstimate) -> Keyframe:
    affine_a, affine_b = keyframe.affine
    # What is not known is zero: all that is published is finite.
    log_scale, sigma, common_sigma = keyframe.scale if all(map(math.isfinite, keyframe.scale)) else (0.0, 0.0, 0.0)
    return Keyframe(
        id=keyframe.keyframe_id,
        stamp=ros_time(keyframe.stamp_ns),
        segment=keyframe.segment,
        pose=pose_from_matrix(keyframe.T_world_camera),
        affine_a=affine_a,
        affine_b=affine_b,
        leaves=keyframe.leaves,
        depth=keyframe.depth,
        log_scale=log_scale,
        log_scale_sigma=sigma,
        log_scale_common_sigma=common_sigma,
    )
