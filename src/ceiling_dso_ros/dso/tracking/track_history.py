# SPDX-License-Identifier: BSD-3-Clause
"""Predicts the next frame's motion from the last two frames, and doubts frames that have moved too far."""

from typing import Callable, Iterable, List, NamedTuple, Optional, Tuple

import numpy as np

from ceiling_dso_ros.dso.durations import seconds
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.geometry.camera_motion import CameraMotion
from ceiling_dso_ros.dso.images.frame import Frame
from ceiling_dso_ros.dso.tracking.frame_tracker import TrackedFrame, flow_of, motion_hypotheses
from ceiling_dso_ros.dso.tracking.tracking_reference import TrackingReference

JITTER = 0.1  # share of the time between two frames that their stamps may be off without telling of another motion
LONGEST_STRETCH = 5.0  # a motion is taken to go on like that for so many times its own duration
# By how much the flow of a frame may differ from what was expected: by a multiple of the expected flow itself, by an
# angle that covers vibrations, and by what the strongest acceleration makes of a constant velocity: 1 g, 1 m away.
SURPRISING_CHANGE = 3.0
SURPRISING_ANGLE = 0.005  # rad
LARGEST_ACCELERATION = 10.0  # rad / s^2


class RelativePose(NamedTuple):
    """Pose of a frame on a keyframe, which may still be refined.

    Attributes:
        keyframe_id: the keyframe.
        T_keyframe_camera: (4, 4) float64.
        stamp_ns: stamp of the frame; None for the first frame of a map, which lies further back than the last but one.
    """

    keyframe_id: int
    T_keyframe_camera: np.ndarray
    stamp_ns: Optional[int]


class TrackHistory:
    """Poses of the last two frames, and brightness and error of the last one.

    Attributes:
        affine: (2,) brightness (a, b) of the last frame.
        rmse: its photometric error, grey levels; infinite before there was one.
    """

    def __init__(self) -> None:
        self._poses: List[RelativePose] = []
        self._missed = 0  # frames without a pose since the last one with a pose
        self._T_doubtful_world: Optional[np.ndarray] = None  # pose of a frame that `doubts` was told of last
        self.affine = np.zeros(2)
        self.rmse = np.inf

    def remember(self, frame: Frame, reference: TrackingReference, rmse: float) -> np.ndarray:
        """Take in a frame with its pose; returns T_keyframe_camera, (4, 4), on the reference's keyframe."""
        T_keyframe_camera = reference.T_camera_world @ se3.inverse(frame.T_camera_world)
        self._poses = [*self._poses[-1:], RelativePose(reference.keyframe_id, T_keyframe_camera, frame.stamp_ns)]
        self.affine, self.rmse, self._missed = frame.affine, rmse, 0
        self._T_doubtful_world = None
        return T_keyframe_camera

    def miss(self, stamp_ns: int, patience_s: float) -> bool:
        """Take note of a frame without a pose; returns whether it is worth while to try another one.

        It is if the last pose is not older than the patience, and always after a single such frame.
        """
        self._missed += 1
        return self._missed == 1 or self._since_last_s(stamp_ns) <= patience_s

    def begin(self, keyframe_id: int) -> None:
        """Begin with a frame that is a keyframe itself."""
        self._poses = [RelativePose(keyframe_id, np.eye(4), None)]

    def hypotheses(
        self, reference: TrackingReference, pose_of: Callable[[int], np.ndarray], stamp_ns: int,
        prediction: Optional[CameraMotion],
    ) -> Iterable[np.ndarray]:  # fmt: skip
        """T_frame_reference of the next frame to try, likeliest first.

        Args:
            reference: the newest keyframe.
            pose_of: T_world_camera, (4, 4), of a keyframe by its identity.
            stamp_ns: of the next frame.
            prediction: motion from the last frame to the next one, predicted by other sensors, if there is one.
        """
        return motion_hypotheses(*self._expected(reference, pose_of, stamp_ns), prediction)

    def doubts(
        self, tracked: TrackedFrame, reference: TrackingReference, pose_of: Callable[[int], np.ndarray], stamp_ns: int,
        prediction: Optional[CameraMotion],
    ) -> bool:  # fmt: skip
        """Whether a frame has moved as no camera does, and the frame before has not confirmed it.

        So does an old image with a new stamp, or one that is torn: its pose fits, but it is that of another time. If
        the frame before was left out for the same reason and this one agrees with it, the camera has really moved.

        Args:
            tracked: result of its tracking against the reference.
            reference, pose_of, stamp_ns, prediction: as for `hypotheses`.
        """
        T_last_reference, T_next_last = self._expected(reference, pose_of, stamp_ns)
        angle = SURPRISING_ANGLE
        if prediction is None:
            angle += LARGEST_ACCELERATION * self._since_last_s(stamp_ns) ** 2
        most = SURPRISING_CHANGE * flow_of(T_next_last, reference) + angle * reference.intrinsics[0]
        T_frame_last = tracked.T_frame_reference @ se3.inverse(T_last_reference)
        expected = [T_next_last] if prediction is None else [T_next_last, se3.inverse(prediction.T_start_end)]
        moved = min(flow_of(T_frame_last @ se3.inverse(T), reference) for T in expected)
        T_before_world, self._T_doubtful_world = self._T_doubtful_world, None
        if moved <= most:
            return False
        T_frame_world = tracked.T_frame_reference @ reference.T_camera_world
        if T_before_world is not None:
            T_frame_before = T_frame_world @ se3.inverse(T_before_world)
            if flow_of(T_frame_before @ se3.inverse(T_next_last), reference) <= most:
                return False
        self._T_doubtful_world = T_frame_world
        return True

    def _since_last_s(self, stamp_ns: int) -> float:
        """Seconds from the last frame with a pose to a stamp, 0 before there is one."""
        last_ns = self._poses[-1].stamp_ns
        return 0.0 if last_ns is None else seconds(stamp_ns - last_ns)

    def _expected(
        self, reference: TrackingReference, pose_of: Callable[[int], np.ndarray], stamp_ns: int
    ) -> Tuple[np.ndarray, np.ndarray]:
        """T_last_reference, and T_next_last with the velocity of the last two frames."""
        last, previous = (
            pose_of(pose.keyframe_id) @ pose.T_keyframe_camera for pose in (self._poses[-1], self._poses[0])
        )
        T_last_reference = se3.inverse(reference.T_camera_world @ last)
        return T_last_reference, self._stretched(se3.inverse(last) @ previous, stamp_ns)

    def _stretched(self, T_last_previous: np.ndarray, stamp_ns: int) -> np.ndarray:
        """T_next_last with the velocity of the last two frames; the same motion where frames come regularly."""
        previous, last = self._poses[0], self._poses[-1]
        if previous.stamp_ns is None or last.stamp_ns is None:
            return T_last_previous
        ratio = min((stamp_ns - last.stamp_ns) / (last.stamp_ns - previous.stamp_ns), LONGEST_STRETCH)
        return T_last_previous if abs(ratio - 1.0) <= JITTER else se3.exp(ratio * se3.log(T_last_previous))
