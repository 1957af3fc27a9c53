# SPDX-License-Identifier: BSD-3-Clause
"""What the nodes say of keyframes that have left the window, as ROS messages."""

from typing import List

import numpy as np
from geometry_msgs.msg import Pose2D
from std_msgs.msg import Header

from ceiling_dso_ros.dso import PinholeCamera
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.estimator import FusionEstimator
from ceiling_dso_ros.fusion.leaving import LeavingKeyframe
from ceiling_dso_ros.fusion.tilt import Tilt
from ceiling_dso_ros.io.limits import LARGEST_M
from ceiling_dso_ros.msg import KeyframeView as KeyframeViewMessage
from ceiling_dso_ros.msg import LeftKeyframe
from ceiling_dso_ros.ros.conversions import matrix_from_pose, pose_from_matrix, ros_time
from ceiling_dso_ros.ros.data_clock import DataClock
from ceiling_dso_ros.slam.records import CORNERS_WIDTH_PX, KeyframeView

POINT = np.dtype("<f4")
MOST_POINTS = 1_000_000
SMALLEST_VARIANCE = 1e-14
LARGEST_TILT_RAD = 0.5


def view_message(view: KeyframeView, stamp_ns: int, camera_frame_id: str) -> KeyframeViewMessage:
    """KeyframeView of a view, with the data's own stamp."""
    camera = view.camera
    return KeyframeViewMessage(
        header=Header(stamp=ros_time(stamp_ns), frame_id=camera_frame_id),
        id=view.keyframe_id,
        width=camera.width,
        height=camera.height,
        intrinsics=[camera.fx, camera.fy, camera.cx, camera.cy],
        grey=np.ascontiguousarray(view.image).tobytes(),
        points=np.ascontiguousarray(view.points, POINT).tobytes(),
    )


def view_from_message(message: KeyframeViewMessage) -> KeyframeView:
    """The inverse of `view_message`.

    Raises:
        ValueError: the sizes do not fit together, or a number is not finite.
    """
    width, height = message.width, message.height
    fx, fy, cx, cy = message.intrinsics
    if not 0 < width <= CORNERS_WIDTH_PX or len(message.grey) != width * height:
        raise ValueError(f"{len(message.grey)} bytes of an image of {width}x{height}")
    if not np.isfinite(message.intrinsics).all() or min(fx, fy) <= 0.0:
        raise ValueError("the camera's intrinsics are none")
    if len(message.points) % (3 * POINT.itemsize) or len(message.points) > MOST_POINTS:
        raise ValueError(f"{len(message.points)} bytes are no points")
    points = np.frombuffer(message.points, POINT).reshape(-1, 3)
    if not np.isfinite(points).all() or (points[:, 2:] <= 0.0).any():
        raise ValueError("points that are not finite, or not before the camera")
    image = np.frombuffer(message.grey, np.uint8).reshape(height, width)
    camera = PinholeCamera(fx, fy, cx, cy, width, height)
    return KeyframeView(message.header.stamp.to_nsec(), message.id, image, camera, points)


def left_messages(estimator: FusionEstimator, clock: DataClock) -> List[LeftKeyframe]:
    """LeftKeyframe of each keyframe that has left since the last call; the frame is left to the publisher.

    Args:
        estimator: the fusion.
        clock: gives the data's stamps.
    """
    messages = []
    for left in estimator.take_left():
        message = LeftKeyframe(
            header=Header(stamp=ros_time(clock.stamp_ns(left.image_ns))),
            id=left.keyframe_id,
            pose=_pose_2d(planar.compose(estimator.origin, left.pose)),
            motion=_pose_2d(left.motion),
            covariance=left.covariance.ravel().tolist(),
            metres_per_unit=left.metres_per_unit,
            newest=ros_time(clock.stamp_ns(left.newest_ns)),
            to_newest=_pose_2d(left.to_newest),
            tilt=left.tilt.angles.tolist(),
            tilt_sigma=left.tilt.sigmas.tolist(),
            mount=pose_from_matrix(estimator.robot.T_base_camera),
        )
        if left.before_ns is not None:
            message.before = ros_time(clock.stamp_ns(left.before_ns))
        messages.append(message)
    return messages


def left_from_message(message: LeftKeyframe) -> LeavingKeyframe:
    """The inverse of `left_messages`; stamps are those of the data, the pose is in odom.

    Raises:
        ValueError: a number is not finite or beyond all bounds, or a covariance is none.
    """
    before = message.before
    covariance = np.reshape(message.covariance, (3, 3))
    scale = message.metres_per_unit
    if not np.isfinite(covariance).all() or np.abs(covariance).max() > LARGEST_M**2:
        raise ValueError("the covariance of a motion is not finite, or beyond all bounds")
    if not before.is_zero() and np.linalg.eigvalsh(covariance)[0] < SMALLEST_VARIANCE:
        raise ValueError("the covariance of a motion is not positive")
    if not 0.0 < scale < LARGEST_M:
        raise ValueError(f"a scale of {scale} metres per unit")
    tilt = Tilt(np.array(message.tilt), np.array(message.tilt_sigma))
    if not (np.abs([tilt.angles, tilt.sigmas]) < LARGEST_TILT_RAD).all() or not (tilt.sigmas > 0.0).all():
        raise ValueError("a tilt is not finite, beyond all bounds, or has no sigma")
    return LeavingKeyframe(
        message.id,
        message.header.stamp.to_nsec(),
        None if before.is_zero() else before.to_nsec(),
        _pose_of(message.pose),
        _pose_of(message.motion),
        covariance,
        scale,
        message.newest.to_nsec(),
        _pose_of(message.to_newest),
        tilt,
    )


def mount_of(message: LeftKeyframe) -> np.ndarray:
    """(4, 4) T_base_camera.

    Raises:
        ValueError: it is no pose.
    """
    return matrix_from_pose(message.mount)


def _pose_2d(pose: np.ndarray) -> Pose2D:
    return Pose2D(*pose.tolist())


def _pose_of(pose: Pose2D) -> np.ndarray:
    result = np.array([pose.x, pose.y, pose.theta])
    if not np.isfinite(result).all() or np.abs(result).max() > LARGEST_M:
        raise ValueError("a pose is not finite, or beyond all bounds")
    return result
