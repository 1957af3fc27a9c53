# SPDX-License-Identifier: BSD-3-Clause
"""Whether the camera turns with the wheels at the stamps of its images, or at others."""

from collections import deque
from typing import Deque, NamedTuple, Optional

import numpy as np

from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.status import OdometryStatus, TrackingState
from ceiling_dso_ros.fusion.visual import VisualMotion
from ceiling_dso_ros.fusion.wheel_track import WheelTrack

TURN_SIGMA_RAD = 0.005  # of the difference of two turns from image to image; 5 ms of jitter at 1 rad/s
CLEAR = 10.0  # logarithm of the odds
MOST_MISFIT = 4.0  # mean squared difference, in sigmas, of turns that agree
MOST_TURNS = 150


class _Turn(NamedTuple):
    """Of the camera about the floor's normal between two images, stamped on the wheels' clock."""

    start_ns: int
    end_ns: int
    turn_rad: float


class TurnCheck:
    """Compares the turns of camera and wheels while it is suspected that the stamps of the images are wrong.

    The camera's are those between images of one keyframe, which need neither scale nor graph. Only changes of the rate
    tell times apart: whoever drives straight on or turns steadily learns nothing.
    """

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Begin with the next image."""
        self._last: Optional[OdometryStatus] = None
        self._turns: Deque[_Turn] = deque(maxlen=MOST_TURNS)

    def add(self, status: OdometryStatus, T_base_camera: np.ndarray, offset_ns: int) -> None:
        """Take in an image.

        Args:
            status: of the image.
            T_base_camera: (4, 4).
            offset_ns: its time on the wheels' clock, minus its stamp.
        """
        last, self._last = self._last, status
        if last is None or not _are_related(last, status):
            return
        assert last.T_keyframe_camera is not None and status.T_keyframe_camera is not None  # of TRACKING
        T = se3.inverse(last.T_keyframe_camera) @ status.T_keyframe_camera
        turn_rad = VisualMotion.from_camera(T, T_base_camera).yaw
        self._turns.append(_Turn(last.stamp_ns + offset_ns, status.stamp_ns + offset_ns, turn_rad))

    def agrees(self, track: WheelTrack, ahead_ns: int) -> bool:
        """Whether the stamps are clearly right.

        Args:
            track: of the wheels.
            ahead_ns: by which the stamps of the images are after their times, if they are wrong.
        """
        if track.empty:
            return False
        early, late = min(0, -ahead_ns), max(0, -ahead_ns)
        known = [t for t in self._turns if t.start_ns + early >= track.start_ns and t.end_ns + late <= track.end_ns]
        if not known:
            return False
        starts_ns, ends_ns = (np.array(stamps) for stamps in zip(*((turn.start_ns, turn.end_ns) for turn in known)))
        seen = np.array([turn.turn_rad for turn in known])
        misfit, other = (
            (((seen - track.turned(ends_ns - shift) + track.turned(starts_ns - shift)) / TURN_SIGMA_RAD) ** 2).sum()
            for shift in (0, ahead_ns)
        )
        return bool(0.5 * (other - misfit) > CLEAR and misfit < MOST_MISFIT * len(known))


def _are_related(before: OdometryStatus, after: OdometryStatus) -> bool:
    """Whether the motion between two images is known, and of an image that follows soon."""
    return (
        before.state is after.state is TrackingState.TRACKING
        and (before.segment, before.keyframe_id) == (after.segment, after.keyframe_id)
        and before.stamp_ns < after.stamp_ns
    )
