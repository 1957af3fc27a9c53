# SPDX-License-Identifier: BSD-3-Clause
"""Converts messages of the visual odometry into statuses, with stamps on the fusion's clock."""

import math
from collections import deque
from typing import Deque, Dict, Optional, Sequence, Tuple

import numpy as np

from ceiling_dso_ros.dso import KeyframeEstimate, OdometryStatus, TrackingState
from ceiling_dso_ros.dso.status import NO_SCALE, ScaleMeasurement
from ceiling_dso_ros.msg import Keyframe, Keyframes, RelativePose, VisualOdometryStatus
from ceiling_dso_ros.ros.conversions import STATES, covariance_from_message, matrix_from_pose
from ceiling_dso_ros.ros.data_clock import DataClock

STATE_OF_NUMBER = {number: state for state, number in STATES.items()}
LAST_SEGMENT = 2**31 - 1  # what is published of it has one bit less
ROUNDING = 1e-9  # of a covariance, relative to its largest variance
MOST_WRONG = 1000  # stamps that are kept: an image becomes a keyframe soon or never


class VisualInput:
    """Converts the messages of one run.

    A stamp of a keyframe is converted when it is heard of for the first time, soon after its image, and keeps its time
    from then on. Later, when the clock has been set back, the same stamp could as well mean a time after that.

    Args:
        clock: of the wheels.
    """

    def __init__(self, clock: DataClock) -> None:
        self._clock = clock
        # By id and stamp of a keyframe of the newest window; None if its image has a wrong stamp.
        self._inner_ns: Dict[Tuple[int, int], Optional[int]] = {}
        self._wrong_ns: Deque[int] = deque(maxlen=MOST_WRONG)
        self._new: Tuple[Tuple[int, int], ...] = ()  # keyframes that were heard of for the first time with the last one

    def reset(self) -> None:
        """Begin a run."""
        self._inner_ns, self._new = {}, ()
        self._wrong_ns.clear()

    def distrust(self, message: VisualOdometryStatus) -> None:
        """Take note that the last status has a wrong stamp: if its image is a keyframe, that has no place in time."""
        stamp_ns = message.header.stamp.to_nsec()
        self._wrong_ns.append(stamp_ns)
        self._inner_ns.update({name: None for name in self._new if name[1] == stamp_ns})

    def status(self, message: VisualOdometryStatus) -> Optional[OdometryStatus]:
        """The parts of a status that the fusion needs; None for an image that the odometry did not use.

        Raises:
            ValueError: a pose, its covariance or its segment is not valid, or there are several.
        """
        if len(message.pose) > 1:
            raise ValueError(f"{len(message.pose)} poses of one image")
        state = STATE_OF_NUMBER.get(message.state, TrackingState.INITIALIZING)
        tracked = state is TrackingState.TRACKING
        if tracked != bool(message.pose):
            return None
        begin = message.predict_from
        return OdometryStatus(
            stamp_ns=self._clock.inner_ns(message.header.stamp.to_nsec()),
            state=state,
            segment=_segment(message.segment),
            is_keyframe=message.is_keyframe,
            keyframe_id=message.pose[0].keyframe_id if tracked else -1,
            T_keyframe_camera=matrix_from_pose(message.pose[0].pose) if tracked else None,
            relative_covariance=_covariance(message.pose[0]) if tracked else None,
            keyframes=self._keyframes(message.keyframes),
            rmse=message.rmse,
            message=message.message,
            earlier_start_ns=None if begin.is_zero() else self._clock.inner_ns(begin.to_nsec()),
        )

    def window(self, message: Keyframes) -> OdometryStatus:
        """The window alone, without a pose of an image.

        Raises:
            ValueError: a pose or its segment is not valid.
        """
        keyframes = self._keyframes(message.keyframes)
        stamp_ns = self._clock.inner_ns(message.header.stamp.to_nsec())
        segment = keyframes[-1].segment if keyframes else 0
        return OdometryStatus(stamp_ns, TrackingState.INITIALIZING, segment, keyframes=keyframes)

    def _keyframes(self, messages: Sequence[Keyframe]) -> Tuple[KeyframeEstimate, ...]:
        if messages:
            names = [(message.id, message.stamp.to_nsec()) for message in messages]
            self._new = tuple(name for name in names if name not in self._inner_ns)
            self._inner_ns = {name: self._inner_ns.get(name, self._placed(name[1])) for name in names}
        placed = ((message, self._inner_ns[message.id, message.stamp.to_nsec()]) for message in messages)
        return tuple(_keyframe(message, inner_ns) for message, inner_ns in placed if inner_ns is not None)

    def _placed(self, stamp_ns: int) -> Optional[int]:
        return None if stamp_ns in self._wrong_ns else self._clock.inner_ns(stamp_ns)


def _keyframe(message: Keyframe, inner_ns: int) -> KeyframeEstimate:
    return KeyframeEstimate(
        keyframe_id=message.id,
        stamp_ns=inner_ns,
        segment=_segment(message.segment),
        T_world_camera=matrix_from_pose(message.pose),
        affine=(message.affine_a, message.affine_b),
        leaves=message.leaves,
        depth=message.depth if 0.0 < message.depth < math.inf else math.nan,
        scale=ScaleMeasurement(message.log_scale, message.log_scale_sigma, message.log_scale_common_sigma)
        if message.log_scale_sigma > 0.0
        else NO_SCALE,
    )


def _segment(number: int) -> int:
    if number > LAST_SEGMENT:
        raise ValueError(f"the segment {number} is beyond {LAST_SEGMENT}")
    return number


def _covariance(pose: RelativePose) -> Optional[np.ndarray]:
    """(6, 6); None where it is unknown.

    Raises:
        ValueError: it is not a covariance.
    """
    covariance = covariance_from_message(pose.covariance)
    if not covariance.any():
        return None
    covariance = 0.5 * (covariance + covariance.T)
    variances = np.linalg.eigvalsh(covariance)
    if variances[0] < -ROUNDING * variances[-1]:
        raise ValueError("the covariance of a pose has negative variances")
    return covariance
