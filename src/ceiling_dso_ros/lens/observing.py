# SPDX-License-Identifier: BSD-3-Clause
"""What the adjustment of a drive needs of the odometry: poses of the images, and keyframes with their images."""

from types import MappingProxyType
from typing import Dict, Iterable, List, Mapping, NamedTuple, Optional

import numpy as np

from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.dso.status import KeyframeEstimate, OdometryStatus
from ceiling_dso_ros.fusion.calibration_data import CameraPose, camera_poses
from ceiling_dso_ros.fusion.metric_scale import SegmentScale, segment_scales
from ceiling_dso_ros.io.recording import Frame
from ceiling_dso_ros.lens.tracks import SeenKeyframe
from ceiling_dso_ros.playback.keyframe_recorder import KeyframeRecorder
from ceiling_dso_ros.playback.visual_run import VisualRun
from ceiling_dso_ros.slam.records import KeyframeView


class ObservedDrive(NamedTuple):
    """Poses of all tracked images, the keyframes with their images, and the scales of segments by a second camera."""

    poses: List[CameraPose]
    keyframes: List[SeenKeyframe]
    scales: Mapping[int, SegmentScale] = MappingProxyType({})


class DriveObserver:
    """Collects them while a drive is tracked."""

    def __init__(self, camera: PinholeCamera, most_keyframes: Optional[int] = None) -> None:
        """Begin.

        Args:
            camera: of the undistorted images.
            most_keyframes: what comes after so many is not kept; None keeps all.
        """
        self._recorder: Optional[KeyframeRecorder] = KeyframeRecorder(camera)
        self._most = most_keyframes
        self._statuses: List[OdometryStatus] = []
        self._views: List[KeyframeView] = []
        self._estimates: Dict[int, KeyframeEstimate] = {}

    def add(self, image: np.ndarray, status: OdometryStatus) -> None:
        """Add an image, (height, width) float32 and undistorted, with its result."""
        if self._recorder is None:
            return
        self._statuses.append(status)
        for keyframe in status.keyframes:
            self._estimates[keyframe.keyframe_id] = keyframe
        self._views += self._recorder.add(image, status)
        if self._most is not None and len(self._views) >= self._most:
            self._recorder = None  # and its images

    def drive(self) -> ObservedDrive:
        """What was collected; keyframes that are still in the window are left out."""
        views = sorted(self._views, key=lambda view: view.stamp_ns)
        keyframes = [
            SeenKeyframe(view.stamp_ns, known.segment, known.T_world_camera, view.image, view.camera, view.points)
            for view, known in ((view, self._estimates[view.keyframe_id]) for view in views)
        ]
        return ObservedDrive(camera_poses(self._statuses), keyframes, segment_scales(self._estimates.values()))


def observe(visual: VisualRun, frames: Iterable[Frame]) -> ObservedDrive:
    """Track all images."""
    observer = DriveObserver(visual.preprocess.camera)
    for frame in frames:
        tracked = visual.track(frame.image, frame.stamp_ns, frame.exposure_ms, right=frame.right)
        observer.add(tracked.image, tracked.status)
    return observer.drive()
