"""The visual odometry's messages as the values that they were made from."""

from collections import deque
from dataclasses import replace
from typing import Deque, List, NamedTuple, Optional, Tuple

from ceiling_dso_ros.dso import KeyframeEstimate, OdometryStatus, TrackingState
from ceiling_dso_ros.io.stamps import seconds
from ceiling_dso_ros.msg import Keyframe, Keyframes, VisualOdometryStatus
from ceiling_dso_ros.ros.conversions import STATES, matrix_from_pose

STATE_OF_NUMBER = {number: state for state, number in STATES.items()}
Window = Tuple[KeyframeEstimate, ...]
LONGEST_WAIT = 10  # statuses, for keyframes that were sent before this node listened


class _Waiting(NamedTuple):
    status: OdometryStatus
    window_changed: bool  # its keyframes come by the other connection


class VisualInput:
    """Brings statuses and keyframes, which arrive over two connections, back together and in order."""

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Forget what is waiting."""
        self._statuses: Deque[_Waiting] = deque()
        self._windows: Deque[Tuple[float, Window]] = deque(maxlen=2 * LONGEST_WAIT)

    def add_status(self, message: VisualOdometryStatus) -> List[OdometryStatus]:
        """Take in a status; returns what is complete now.

        Raises:
            ValueError: its pose is none.
        """
        self._statuses.append(_Waiting(_status(message), message.window_changed))
        return self._complete()

    def add_keyframes(self, message: Keyframes) -> List[OdometryStatus]:
        """Take in keyframes; returns what is complete now.

        Raises:
            ValueError: one of the poses is none.
        """
        window = tuple(_keyframe(keyframe) for keyframe in message.keyframes)
        self._windows.append((seconds(message.header.stamp.to_nsec()), window))
        return self._complete()

    def _complete(self) -> List[OdometryStatus]:
        complete = []
        while self._statuses:
            window = self._window_of(self._statuses[0])
            if window is None and len(self._statuses) <= LONGEST_WAIT:
                break
            complete.append(replace(self._statuses.popleft().status, keyframes=window or ()))
        return complete

    def _window_of(self, waiting: _Waiting) -> Optional[Window]:
        """None when it is still to come."""
        if not waiting.window_changed:
            return ()
        return next((window for stamp_s, window in self._windows if stamp_s == waiting.status.stamp_s), None)


def _status(message: VisualOdometryStatus) -> OdometryStatus:
    """What the fusion needs of an image but the keyframes."""
    state = STATE_OF_NUMBER.get(message.state, TrackingState.INITIALIZING)
    tracked = state is TrackingState.TRACKING
    return OdometryStatus(
        stamp_s=seconds(message.header.stamp.to_nsec()),
        state=state,
        segment=message.segment,
        is_keyframe=message.is_keyframe,
        keyframe_id=message.keyframe_id,
        T_keyframe_camera=matrix_from_pose(message.pose_in_keyframe) if tracked else None,
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
