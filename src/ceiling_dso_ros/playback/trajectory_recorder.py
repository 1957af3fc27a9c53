# SPDX-License-Identifier: BSD-3-Clause
"""Collects the odometry's results into trajectories."""

from array import array
from typing import Callable, Dict, Mapping, Tuple

import numpy as np

from ceiling_dso_ros.dso.status import KeyframeEstimate, OdometryStatus
from ceiling_dso_ros.io.stamps import format_stamp
from ceiling_dso_ros.io.trajectory import Trajectory


class TrajectoryRecorder:
    """Stores every tracked frame and the last estimate of every keyframe, 272 bytes per frame."""

    def __init__(self) -> None:
        self._stamps_ns = array("q")
        self._keyframe_ids = array("q")
        self._T_world_camera = array("d")
        self._T_keyframe_camera = array("d")
        self._keyframes: Dict[int, KeyframeEstimate] = {}

    def add(self, status: OdometryStatus) -> None:
        """Add the result of one frame; frames must be in the order of time.

        Raises:
            KeyError: the frame refers to a keyframe that no status has described.
        """
        self._keyframes.update((keyframe.keyframe_id, keyframe) for keyframe in status.keyframes)
        if status.T_world_camera is None or status.T_keyframe_camera is None:
            return
        if status.keyframe_id not in self._keyframes:
            stamp = format_stamp(status.stamp_ns)
            raise KeyError(f"the frame of {stamp} s refers to the unknown keyframe {status.keyframe_id}")
        self._stamps_ns.append(status.stamp_ns)
        self._keyframe_ids.append(status.keyframe_id)
        self._T_world_camera.extend(status.T_world_camera.ravel())
        self._T_keyframe_camera.extend(status.T_keyframe_camera.ravel())

    @property
    def estimates(self) -> Mapping[int, KeyframeEstimate]:
        """keyframe_id -> the keyframe as last refined."""
        return self._keyframes

    @property
    def segments(self) -> int:
        """Number of segments that have a keyframe."""
        return len({keyframe.segment for keyframe in self._keyframes.values()})

    def live(self) -> Trajectory:
        """T_world_camera of the tracked frames as known when each was processed."""
        return Trajectory.from_matrices(self._stamps_ns, self._T_world_camera)

    def final(self) -> Trajectory:
        """T_world_camera of the tracked frames, with the last estimate of their keyframes."""
        stamps_ns, _, T_world_camera = self.final_matrices()
        return Trajectory.from_matrices(stamps_ns, T_world_camera)

    def final_matrices(self) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The same as stamps (N,) int64, segments (N,) int64, and poses (N, 4, 4) float64."""
        keyframes = [self._keyframes[keyframe_id] for keyframe_id in self._keyframe_ids]
        T_world_keyframe = np.reshape([keyframe.T_world_camera for keyframe in keyframes], (-1, 4, 4))
        T_keyframe_camera = np.reshape(self._T_keyframe_camera, (-1, 4, 4))
        segments = np.array([keyframe.segment for keyframe in keyframes], np.int64)
        return np.array(self._stamps_ns, np.int64), segments, T_world_keyframe @ T_keyframe_camera

    def keyframes(self) -> Trajectory:
        """T_world_camera of all keyframes as last refined, by stamp."""
        keyframes = sorted(self._keyframes.values(), key=lambda keyframe: keyframe.stamp_ns)
        return Trajectory.from_matrices(
            [keyframe.stamp_ns for keyframe in keyframes], [keyframe.T_world_camera for keyframe in keyframes]
        )

    def files(self) -> Dict[str, Callable[[], Trajectory]]:
        """Names of files -> what makes their trajectory: T_world_camera in VO units."""
        return {"camera.tum": self.live, "camera_final.tum": self.final, "keyframes.tum": self.keyframes}
