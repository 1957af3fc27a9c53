# SPDX-License-Identifier: BSD-3-Clause
"""The map as the odometry last refined it."""

from dataclasses import dataclass
from typing import NamedTuple, Tuple

import numpy as np

from ceiling_dso_ros.dso.hosted_points import HostedPoints
from ceiling_dso_ros.dso.images.vignette import Vignette
from ceiling_dso_ros.dso.status import KeyframeEstimate
from ceiling_dso_ros.dso.tracking.tracking_reference import TrackingReference
from ceiling_dso_ros.dso.window.keyframe_window import KeyframeWindow


class MapPoints(NamedTuple):
    """The active points with a positive inverse depth.

    Attributes:
        positions: (N, 3) float64 in the VO world, VO units.
        grey: (N,) float32 grey level in the keyframe that hosts the point.
    """

    positions: np.ndarray
    grey: np.ndarray


NO_POINTS = MapPoints(np.zeros((0, 3)), np.zeros(0, np.float32))


@dataclass(frozen=True)
class MapSnapshot:
    """The map after a keyframe was added; it does not change while the mapping continues.

    Attributes:
        reference: the new keyframe with its depth, to track against.
        keyframes: all keyframes of the window, oldest first, including those that leave it now.
        rmse: photometric error of the bundle adjustment, grey levels.
        window_points: the active points.
        marginalized: the points that were marginalised with this keyframe.
        active_points, candidate_points: how many the window holds.
        vignette: by which the reference's image was divided.
    """

    reference: TrackingReference
    keyframes: Tuple[KeyframeEstimate, ...]
    rmse: float
    window_points: HostedPoints
    marginalized: HostedPoints
    active_points: int
    candidate_points: int
    vignette: Vignette

    @classmethod
    def of(
        cls, window: KeyframeWindow, reference: TrackingReference, keyframes: Tuple[KeyframeEstimate, ...], rmse: float,
        marginalized: HostedPoints,
    ) -> "MapSnapshot":  # fmt: skip
        """Snapshot of a window; copies everything that may change."""
        count = window.points.count
        points = window.hosted_points(np.ones(count, bool))
        vignette = window.pool.vignette(int(window.keyframes.image_slot[window.newest]))
        return cls(reference, keyframes, rmse, points, marginalized, count, window.candidates.count, vignette)

    @property
    def points(self) -> MapPoints:
        """The window's points in the world."""
        poses = {keyframe.keyframe_id: keyframe.T_world_camera for keyframe in self.keyframes}
        return MapPoints(self.window_points.positions_world(poses), self.window_points.grey)

    @property
    def stamp_ns(self) -> int:
        """Stamp of the new keyframe's image, nanoseconds."""
        return self.keyframes[-1].stamp_ns

    def pose_of(self, keyframe_id: int) -> np.ndarray:
        """T_world_camera of one of the keyframes."""
        return next(keyframe.T_world_camera for keyframe in self.keyframes if keyframe.keyframe_id == keyframe_id)
