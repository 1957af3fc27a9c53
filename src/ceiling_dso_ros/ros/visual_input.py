# SPDX-License-Identifier: BSD-3-Clause
"""Converts messages of the visual odometry into statuses, with stamps on the fusion's clock."""

from typing import List, Optional

import numpy as np

from ceiling_dso_ros.dso import KeyframeEstimate, OdometryStatus, TrackingState
from ceiling_dso_ros.msg import Keyframe, Keyframes, RelativePose, VisualOdometryStatus
from ceiling_dso_ros.ros.conversions import STATES, matrix_from_pose
from ceiling_dso_ros.ros.data_clock import DataClock

STATE_OF_NUMBER = {number: state for state, number in STATES.items()}
ROUNDING = 1e-9  # of a covariance, relative to its largest variance


def status_from_message(message: VisualOdometryStatus, clock: DataClock) -> Optional[OdometryStatus]:
    """The parts of a status that the fusion needs; None for an image that the odometry did not use.

    Raises:
        ValueError: a pose or its covariance is not valid, or there are several.
    """
    if len(message.pose) > 1:
        raise ValueError(f"{len(message.pose)} poses of one image")
    state = STATE_OF_NUMBER.get(message.state, TrackingState.INITIALIZING)
    tracked = state is TrackingState.TRACKING
    if tracked != bool(message.pose):
        return None
    return OdometryStatus(
        stamp_ns=clock.inner_ns(message.header.stamp.to_nsec()),
        state=state,
        segment=message.segment,
        is_keyframe=message.is_keyframe,
        keyframe_id=message.pose[0].keyframe_id if tracked else -1,
        T_keyframe_camera=matrix_from_pose(message.pose[0].pose) if tracked else None,
        relative_covariance=_covariance(message.pose[0]) if tracked else None,
        keyframes=_keyframes(message.keyframes, clock),
        rmse=message.rmse,
        message=message.message,
    )


def window_from_message(message: Keyframes, clock: DataClock) -> OdometryStatus:
    """The window alone, without a pose of an image.

    Raises:
        ValueError: a pose is not valid.
    """
    keyframes = _keyframes(message.keyframes, clock)
    stamp_ns = clock.inner_ns(message.header.stamp.to_nsec())
    segment = keyframes[-1].segment if keyframes else 0
    return OdometryStatus(stamp_ns, TrackingState.INITIALIZING, segment, keyframes=keyframes)


def _covariance(pose: RelativePose) -> Optional[np.ndarray]:
    """(6, 6); None where it is unknown.

    Raises:
        ValueError: it is not a covariance.
    """
    covariance = np.reshape(pose.covariance, (6, 6))
    if not np.isfinite(covariance).all():
        raise ValueError("the covariance of a pose is not finite")
    if not covariance.any():
        return None
    covariance = 0.5 * (covariance + covariance.T)
    variances = np.linalg.eigvalsh(covariance)
    if variances[0] < -ROUNDING * variances[-1]:
        raise ValueError("the covariance of a pose has negative variances")
    return covariance


def _keyframes(messages: List[Keyframe], clock: DataClock) -> tuple:
    return tuple(_keyframe(message, clock) for message in messages)


def _keyframe(message: Keyframe, clock: DataClock) -> KeyframeEstimate:
    return KeyframeEstimate(
        keyframe_id=message.id,
        stamp_ns=clock.inner_ns(message.stamp.to_nsec()),
        segment=message.segment,
        T_world_camera=matrix_from_pose(message.pose),
        affine=(message.affine_a, message.affine_b),
        leaves=message.leaves,
    )
