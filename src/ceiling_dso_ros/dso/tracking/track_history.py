# SPDX-License-Identifier: BSD-3-Clause
"""Predicts the next frame's motion from the last two frames."""

from typing import Callable, Iterable, List, NamedTuple, Optional

import numpy as np

from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.geometry.camera_motion import CameraMotion
from ceiling_dso_ros.dso.images.frame import Frame
from ceiling_dso_ros.dso.tracking.frame_tracker import motion_hypotheses
from ceiling_dso_ros.dso.tracking.tracking_reference import TrackingReference


class RelativePose(NamedTuple):
    """Pose of a frame on a keyframe, which may still be refined.

    Attributes:
        keyframe_id: the keyframe.
        T_keyframe_camera: (4, 4) float64.
    """

    keyframe_id: int
    T_keyframe_camera: np.ndarray


class TrackHistory:
    """Poses of the last two frames, and brightness and error of the last one.

    Attributes:
        affine: (2,) brightness (a, b) of the last frame.
        rmse: its photometric error, grey levels; infinite before there was one.
    """

    def __init__(self) -> None:
        self._poses: List[RelativePose] = []
        self.affine = np.zeros(2)
        self.rmse = np.inf

    def remember(self, frame: Frame, reference: TrackingReference, rmse: float) -> np.ndarray:
        """Take in a frame with its pose; returns T_keyframe_camera, (4, 4), on the reference's keyframe."""
        T_keyframe_camera = reference.T_camera_world @ se3.inverse(frame.T_camera_world)
        self._poses = [*self._poses[-1:], RelativePose(reference.keyframe_id, T_keyframe_camera)]
        self.affine, self.rmse = frame.affine, rmse
        return T_keyframe_camera

    def begin(self, keyframe_id: int) -> None:
        """Begin with a frame that is a keyframe itself."""
        self._poses = [RelativePose(keyframe_id, np.eye(4))]

    def hypotheses(
        self, reference: TrackingReference, pose_of: Callable[[int], np.ndarray], prediction: Optional[CameraMotion]
    ) -> Iterable[np.ndarray]:
        """T_frame_reference of the next frame to try, likeliest first.

        Args:
            reference: the newest keyframe.
            pose_of: T_world_camera, (4, 4), of a keyframe by its identity.
            prediction: motion from the last frame to the next one, predicted by other sensors, if there is one.
        """
        last, previous = (
            pose_of(pose.keyframe_id) @ pose.T_keyframe_camera for pose in (self._poses[-1], self._poses[0])
        )
        T_last_reference = se3.inverse(reference.T_camera_world @ last)
        return motion_hypotheses(T_last_reference, se3.inverse(last) @ previous, prediction)
