"""The visual odometry's messages as the values that they were made from."""

from collections import deque
from typing import Deque, List, Optional

from ceiling_dso_ros.dso import KeyframeEstimate, OdometryStatus, TrackingState
from ceiling_dso_ros.io.stamps import seconds
from ceiling_dso_ros.msg import Keyframe, Keyframes, VisualOdometryStatus
from ceiling_dso_ros.ros.conversions import STATES, matrix_from_pose

STATE_OF_NUMBER = {number: state for state, number in STATES.items()}
LONGEST_WAIT = 10  # statuses, for keyframes that were sent before this node listened


class VisualInput:
    """Brings statuses and keyframes, which arrive over two connections, back together and in order."""

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Forget what is waiting."""
        self._statuses: Deque[VisualOdometryStatus] = deque()
        self._keyframes: Deque[Keyframes] = deque(maxlen=2 * LONGEST_WAIT)

    def add_status(self, message: VisualOdometryStatus) -> List[OdometryStatus]:
        """Take in a status; returns what is complete now."""
        self._statuses.append(message)
        return self._complete()

    def add_keyframes(self, message: Keyframes) -> List[OdometryStatus]:
        """Take in keyframes; returns what is complete now."""
        self._keyframes.append(message)
        return self._complete()

    def _complete(self) -> List[OdometryStatus]:
        complete = []
        while self._statuses:
            keyframes = self._keyframes_of(self._statuses[0])
            if keyframes is None and len(self._statuses) <= LONGEST_WAIT:
                break
            complete.append(_status(self._statuses.popleft(), keyframes or []))
        return complete

    def _keyframes_of(self, status: VisualOdometryStatus) -> Optional[List[Keyframe]]:
        """None when they are still to come."""
        if not status.window_changed:
            return []
        return next((m.keyframes for m in self._keyframes if m.header.stamp == status.header.stamp), None)


def _status(message: VisualOdometryStatus, keyframes: List[Keyframe]) -> OdometryStatus:
    """What the fusion needs of an image."""
    state = STATE_OF_NUMBER.get(message.state, TrackingState.INITIALIZING)
    tracked = state is TrackingState.TRACKING
    return OdometryStatus(
        stamp_s=seconds(message.header.stamp.to_nsec()),
        state=state,
        segment=message.segment,
        is_keyframe=message.is_keyframe,
        keyframe_id=message.keyframe_id,
        T_keyframe_camera=matrix_from_pose(message.pose_in_keyframe) if tracked else None,
        keyframes=tuple(_keyframe(keyframe) for keyframe in keyframes),
        rmse=message.rmse,
        message=message.message,
    )


def _keyframe(message: Keyframe) -> KeyframeEstimate:
    return KeyframeEstimate(
        keyframe_id=message.id,
        stamp_s=seconds(message.stamp.to_nsec()),
        segment=message.segment,
        T_world_camera=matrix_from_pose(message.pose),
        affine=(message.affine_a, message.affine_b),
        leaves=message.leaves,
    )
