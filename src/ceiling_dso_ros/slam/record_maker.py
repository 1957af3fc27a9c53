# SPDX-License-Identifier: BSD-3-Clause
"""Makes records of what the odometry and the fusion say of the keyframes that leave the window."""

from typing import Dict, List, NamedTuple, Optional

import numpy as np

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.leaving import LeavingKeyframe
from ceiling_dso_ros.slam.deciding import carried
from ceiling_dso_ros.slam.records import KeyframeRecord, KeyframeView, View

MOST_VIEWS = 50  # that wait for their poses
MOST_POSES = 5  # that wait for the view of the one before them


class NewRecord(NamedTuple):
    """A record, and what belongs to its time.

    Attributes:
        record: its pose continues those of the records before by their motions, so it is not exactly in odom.
        begins: no motion is known from the record before: another drive begins.
        newest_ns: stamp of the newest keyframe when this one left, on the wheels' clock.
        to_newest: (3,) motion of base_link from this keyframe to that one.
    """

    record: KeyframeRecord
    begins: bool
    newest_ns: int
    to_newest: np.ndarray


class RecordMaker:
    """Joins views with poses, each of which may come first; records have the order of the poses.

    A pose whose view does not come is left out when MOST_POSES others wait behind it.
    """

    def __init__(self) -> None:
        self._views: Dict[int, KeyframeView] = {}  # by stamp
        self._poses: List[LeavingKeyframe] = []
        self._last: Optional[LeavingKeyframe] = None
        self._pose = np.zeros(3)
        self._covariance = np.zeros((3, 3))  # of the motion since the last record
        self._begins = True

    def add_view(self, view: KeyframeView) -> None:
        """Take in what a keyframe shows."""
        self._views[view.stamp_ns] = view
        while len(self._views) > MOST_VIEWS:
            del self._views[min(self._views)]

    def add_pose(self, pose: LeavingKeyframe) -> None:
        """Take in where a keyframe was; in the order of the fusion."""
        self._poses.append(pose)

    def take(self, T_base_camera: np.ndarray) -> List[NewRecord]:
        """The records that are complete, with the camera's (4, 4) mount."""
        records = []
        while self._poses and (self._poses[0].image_ns in self._views or len(self._poses) > MOST_POSES):
            pose = self._poses.pop(0)
            self._follow(pose)
            view = self._views.pop(pose.image_ns, None)
            if view is not None:
                records.append(self._record(view, pose, T_base_camera))
        return records

    def _follow(self, pose: LeavingKeyframe) -> None:
        if self._last is None or pose.before_ns != self._last.image_ns:
            self._begins, self._pose, self._covariance = True, pose.pose, np.zeros((3, 3))
        else:
            self._pose = planar.compose(self._pose, pose.motion)
            self._covariance = carried(self._covariance, pose.motion, pose.covariance)
        self._last = pose

    def _record(self, view: KeyframeView, pose: LeavingKeyframe, T_base_camera: np.ndarray) -> NewRecord:
        seen = View.of(view.image, view.camera, view.points.astype(np.float64))
        record = seen.record(
            view.stamp_ns, pose.metres_per_unit, T_base_camera, self._pose, self._covariance, pose.tilt
        )
        begins, self._begins, self._covariance = self._begins, False, np.zeros((3, 3))
        return NewRecord(record, begins, pose.newest_ns, pose.to_newest)
