"""The map as the odometry last refined it."""

from dataclasses import dataclass
from typing import NamedTuple, Tuple

import numpy as np

from ceiling_dso_ros.dso.status import KeyframeEstimate
from ceiling_dso_ros.dso.tracking_reference import TrackingReference
from ceiling_dso_ros.dso.window import KeyframeWindow


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
    """What a new keyframe left behind; stays as it is while the mapping goes on.

    Attributes:
        reference: the new keyframe with its depth, to track against.
        keyframes: all of the window, those that leave with it too, oldest first.
        rmse: photometric error of the bundle adjustment, grey levels.
        points: what the window sees of the world.
        active_points, candidate_points: how many the window holds.
    """

    reference: TrackingReference
    keyframes: Tuple[KeyframeEstimate, ...]
    rmse: float
    points: MapPoints
    active_points: int
    candidate_points: int

    @classmethod
    def of(
        cls, window: KeyframeWindow, reference: TrackingReference, keyframes: Tuple[KeyframeEstimate, ...], rmse: float
    ) -> "MapSnapshot":
        """Copy what may change."""
        return cls(reference, keyframes, rmse, map_points(window), window.points.count, window.candidates.count)

    @property
    def stamp_s(self) -> float:
        """Stamp of the new keyframe's image, seconds."""
        return self.keyframes[-1].stamp_s

    def pose_of(self, keyframe_id: int) -> np.ndarray:
        """T_world_camera of one of the keyframes."""
        return next(keyframe.T_world_camera for keyframe in self.keyframes if keyframe.keyframe_id == keyframe_id)


def map_points(window: KeyframeWindow) -> MapPoints:
    """The window's points as they stand."""
    arrays, count = window.points.arrays, window.points.count
    idepth = arrays.idepth[:count].astype(np.float64)
    front = idepth > 0.0
    fx, fy, cx, cy = window.intrinsics
    rays = np.column_stack([(arrays.u[:count] - cx) / fx, (arrays.v[:count] - cy) / fy, np.ones(count)])[front]
    T_world_host = np.array([window.T_world_camera(slot) for slot in range(window.count)])[arrays.host[:count][front]]
    positions = np.einsum("nij,nj->ni", T_world_host[:, :3, :3], rays / idepth[front, None]) + T_world_host[:, :3, 3]
    return MapPoints(positions, arrays.grey[:, :count].mean(axis=0)[front])
