# SPDX-License-Identifier: BSD-3-Clause
"""Predicts the next frame's motion from the last frames, and doubts frames that have moved too far."""

from typing import Callable, Iterator, List, NamedTuple, Optional, Sequence, Tuple

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
SUDDEN_RISE = 1.5  # of the photometric error, from one frame to the next


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


class ExpectedMotion(NamedTuple):
    """How the camera should have moved since the last image with a pose.

    Where several sources tell, the one that tells more of it counts.

    Attributes:
        flow_px: root mean square flow of the newest keyframe's points, pixels.
        turn_rad: angle by which it has turned.
        predicted: other sensors have predicted it; otherwise it is taken to go on as before.
    """

    flow_px: float
    turn_rad: float
    predicted: bool


class DoubtfulFrame(NamedTuple):
    """A frame that moved too far, until the next one confirms it.

    Attributes:
        T_camera_world: (4, 4) float64.
        stamp_ns: its stamp.
        prediction: motion from the last frame with a pose to it, predicted by other sensors, if there is one.
    """

    T_camera_world: np.ndarray
    stamp_ns: int
    prediction: Optional[CameraMotion]


class TrackHistory:
    """Poses of the last three frames, brightness of the last one, and what error is usual.

    Attributes:
        affine: (2,) brightness (a, b) of the last frame.
        rmse: usual photometric error, grey levels: that of the last frame, or of the one before if it has risen
            suddenly, since that may be a bad image. Infinite before there was one.
        blind_s: seconds from the last frame with a pose to the first one without, over which there was no image.
    """

    def __init__(self) -> None:
        self._poses: List[RelativePose] = []
        self.blind_s = 0.0
        self._missed = 0  # frames without a pose since the last one with a pose
        self._doubtful: Optional[DoubtfulFrame] = None  # the frame that `doubts` was told of last
        self.affine = np.zeros(2)
        self.rmse = self._last_rmse = np.inf

    @property
    def last_ns(self) -> Optional[int]:
        """Stamp of the last frame with a pose; None before there is one."""
        return self._poses[-1].stamp_ns

    def remember(self, frame: Frame, reference: TrackingReference, rmse: float) -> np.ndarray:
        """Take in a frame with its pose; returns T_keyframe_camera, (4, 4), on the reference's keyframe."""
        T_keyframe_camera = reference.T_camera_world @ se3.inverse(frame.T_camera_world)
        self._poses = [*self._poses[-2:], RelativePose(reference.keyframe_id, T_keyframe_camera, frame.stamp_ns)]
        self.rmse = rmse if rmse <= SUDDEN_RISE * self._last_rmse else self._last_rmse
        self.affine, self._last_rmse, self._missed = frame.affine, rmse, 0
        self._doubtful = None
        return T_keyframe_camera

    def miss(self, stamp_ns: int, patience_s: float) -> bool:
        """Take note of a frame without a pose; returns whether it is worth while to try another one.

        It is if the last pose is not older than the patience, and always after a single such frame.
        """
        self._missed += 1
        if self._missed == 1:
            self.blind_s = self._since_last_s(stamp_ns)
        return self._missed == 1 or self._since_last_s(stamp_ns) <= patience_s

    def begin(self, keyframe_id: int) -> None:
        """Begin with a frame that is a keyframe itself."""
        self._poses = [RelativePose(keyframe_id, np.eye(4), None)]

    def hypotheses(
        self, reference: TrackingReference, pose_of: Callable[[int], np.ndarray], stamp_ns: int,
        prediction: Optional[CameraMotion],
    ) -> Iterator[np.ndarray]:  # fmt: skip
        """T_frame_reference of the next frame to try, likeliest first.

        Args:
            reference: the newest keyframe.
            pose_of: T_world_camera, (4, 4), of a keyframe by its identity.
            stamp_ns: of the next frame.
            prediction: motion from the last frame to the next one, predicted by other sensors, if there is one.
        """
        yield from motion_hypotheses(*self._expected(reference, pose_of, stamp_ns), prediction)
        if len(self._poses) == 3:  # in case the last frame's pose is wrong, as that of a torn image is
            T_previous_reference, T_next_previous = self._expected(reference, pose_of, stamp_ns, self._poses[:2])
            yield T_next_previous @ T_previous_reference
            yield T_previous_reference

    def expect(
        self, reference: TrackingReference, pose_of: Callable[[int], np.ndarray], stamp_ns: int,
        prediction: Optional[CameraMotion],
    ) -> ExpectedMotion:  # fmt: skip
        """The motion from the last frame to the next one; the arguments are those of `hypotheses`."""
        T_next_last = [self._expected(reference, pose_of, stamp_ns)[1]]
        if prediction is not None:
            T_next_last.append(se3.inverse(prediction.T_start_end))
        flow_px = max(flow_of(T, reference) for T in T_next_last)
        turn_rad = max(float(np.linalg.norm(se3.log(T)[3:])) for T in T_next_last)
        return ExpectedMotion(flow_px, turn_rad, prediction is not None)

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

        def agrees(T_frame_earlier: np.ndarray, expected: Sequence[np.ndarray]) -> bool:
            return any(flow_of(T_frame_earlier @ se3.inverse(T), reference) <= most for T in expected)

        before, self._doubtful = self._doubtful, None
        T_frame_world = tracked.T_frame_reference @ reference.T_camera_world
        by_prediction = [] if prediction is None else [se3.inverse(prediction.T_start_end)]
        if agrees(tracked.T_frame_reference @ se3.inverse(T_last_reference), [T_next_last, *by_prediction]):
            return False
        if len(self._poses) == 3:  # where the last pose was wrong, the camera has gone on from the one before
            T_previous_reference, T_next_previous = self._expected(reference, pose_of, stamp_ns, self._poses[:2])
            if agrees(tracked.T_frame_reference @ se3.inverse(T_previous_reference), [T_next_previous]):
                return False
        if before is not None and agrees(
            T_frame_world @ se3.inverse(before.T_camera_world),
            self._expected_since(before, T_next_last, stamp_ns, prediction),
        ):
            return False
        self._doubtful = DoubtfulFrame(T_frame_world, stamp_ns, prediction)
        return True

    def _expected_since(
        self, before: DoubtfulFrame, T_next_last: np.ndarray, stamp_ns: int, prediction: Optional[CameraMotion]
    ) -> List[np.ndarray]:
        """T_next_before from a doubtful frame: with the velocity of the last two poses, and as others predict it."""
        since_last_s = self._since_last_s(stamp_ns)
        share = 1.0 - self._since_last_s(before.stamp_ns) / since_last_s if since_last_s > 0.0 else 1.0
        expected = [se3.exp(share * se3.log(T_next_last))]
        if prediction is not None and before.prediction is not None:
            expected.append(se3.inverse(prediction.T_start_end) @ before.prediction.T_start_end)
        return expected

    def _since_last_s(self, stamp_ns: int) -> float:
        """Seconds from the last frame with a pose to a stamp, 0 before there is one."""
        last_ns = self._poses[-1].stamp_ns
        return 0.0 if last_ns is None else seconds(stamp_ns - last_ns)

    def _expected(
        self, reference: TrackingReference, pose_of: Callable[[int], np.ndarray], stamp_ns: int,
        poses: Optional[Sequence[RelativePose]] = None,
    ) -> Tuple[np.ndarray, np.ndarray]:  # fmt: skip
        """T_last_reference, and T_next_last with the velocity of the last two frames, or of two others."""
        previous, last = (poses or self._poses)[-2:][0], (poses or self._poses)[-1]
        T_world_last, T_world_previous = (
            pose_of(pose.keyframe_id) @ pose.T_keyframe_camera for pose in (last, previous)
        )
        T_last_reference = se3.inverse(reference.T_camera_world @ T_world_last)
        return T_last_reference, _stretched(se3.inverse(T_world_last) @ T_world_previous, previous, last, stamp_ns)


def _stretched(T_last_previous: np.ndarray, previous: RelativePose, last: RelativePose, stamp_ns: int) -> np.ndarray:
    """T_next_last with the velocity of two frames; the same motion where frames come regularly."""
    if previous.stamp_ns is None or last.stamp_ns is None:
        return T_last_previous
    ratio = min((stamp_ns - last.stamp_ns) / (last.stamp_ns - previous.stamp_ns), LONGEST_STRETCH)
    return T_last_previous if abs(ratio - 1.0) <= JITTER else se3.exp(ratio * se3.log(T_last_previous))
