# SPDX-License-Identifier: BSD-3-Clause
"""One pass of the odometry over a drive, with what the adjustment needs of it."""

from typing import Dict, Iterable, Iterator, List, NamedTuple, Tuple

import numpy as np

from ceiling_dso_ros.dso.status import OdometryStatus
from ceiling_dso_ros.fusion.calibration_data import CameraPose, camera_poses
from ceiling_dso_ros.io.recording import Frame
from ceiling_dso_ros.lens.tracks import SeenKeyframe
from ceiling_dso_ros.playback.keyframe_recorder import KeyframeRecorder
from ceiling_dso_ros.playback.visual_run import VisualRun
from ceiling_dso_ros.slam.records import KeyframeView


class ObservedDrive(NamedTuple):
    """Poses of all tracked images, and the keyframes with their images."""

    poses: List[CameraPose]
    keyframes: List[SeenKeyframe]


def observe(visual: VisualRun, frames: Iterable[Frame]) -> ObservedDrive:
    """Track all images."""
    recorder = KeyframeRecorder(visual.preprocess.camera)
    views: List[KeyframeView] = []
    estimates: Dict[int, Tuple[int, np.ndarray]] = {}

    def statuses() -> Iterator[OdometryStatus]:
        for frame in frames:
            tracked = visual.track(frame.image, frame.stamp_ns, frame.exposure_ms)
            for keyframe in tracked.status.keyframes:
                estimates[keyframe.keyframe_id] = keyframe.segment, keyframe.T_world_camera
            views.extend(recorder.add(tracked.image, tracked.status))
            yield tracked.status

    poses = camera_poses(statuses())
    views.sort(key=lambda view: view.stamp_ns)
    keyframes = [
        SeenKeyframe(view.stamp_ns, *estimates[view.keyframe_id], view.image, view.camera, view.points)
        for view in views
    ]
    return ObservedDrive(poses, keyframes)
