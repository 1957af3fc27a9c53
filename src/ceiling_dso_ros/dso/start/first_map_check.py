# SPDX-License-Identifier: BSD-3-Clause
"""Decides whether a first map is accepted. No pose was published yet, so starting again costs little.

A map of noise, or of one lamp on a bare ceiling, explains its own two images. What it cannot do is to find an image
again: from a start that is moved along the motion that the image determines worst, tracking ends somewhere else.
"""

from typing import Iterable, NamedTuple, Optional

import numpy as np

from ceiling_dso_ros.dso.config import OdometryConfig
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.images.frame import Frame
from ceiling_dso_ros.dso.mapping.map_snapshot import MapSnapshot
from ceiling_dso_ros.dso.tracking.frame_tracker import FrameTracker, TrackedFrame
from ceiling_dso_ros.dso.tracking.tracking_kernels import mean_squared_flow
from ceiling_dso_ros.dso.tracking.tracking_reference import TrackingReference

AWAY_PX = 3.0  # from where an image has to be found again: beyond the reach of the finest level alone
SAME_PX = 0.5  # two results that are nearer are one minimum: beyond it a pixel's gradient says nothing of the error
GRID = 12  # points in a row of the image, at which two poses are compared


class Fault(NamedTuple):
    """Why a map is rejected.

    Attributes:
        reason: in words, as they follow `the first map`.
        more_parallax_helps: the map is doubtful rather than wrong.
    """

    reason: str
    more_parallax_helps: bool


class FirstMapCheck:
    """Accepts or rejects first maps."""

    def __init__(self, config: OdometryConfig, tracker: FrameTracker) -> None:
        self._config = config.initialization
        self._min_points = config.initialization.min_share * config.window.active_points
        self._tracker = tracker

    def fault(self, first_map: MapSnapshot, frames: Iterable[Frame]) -> Optional[Fault]:
        """Why a map is rejected; None if it is accepted.

        Args:
            first_map: made of two frames.
            frames: others, and the first of the two, that must be found in it.
        """
        if first_map.rmse > self._config.max_rmse:
            return Fault(f"does not explain the images ({first_map.rmse:.1f} grey levels)", False)
        if first_map.active_points < self._min_points:
            return Fault(f"has {first_map.active_points} points only", False)
        if not all(self._finds(frame, first_map) for frame in frames):
            return Fault("has too little texture: noise could have made it", True)
        return None

    def _finds(self, frame: Frame, first_map: MapSnapshot) -> bool:
        """Whether a frame is found in the map, and found again from both sides."""
        reference = first_map.reference
        found = self._track(frame, first_map, frame.T_camera_world @ se3.inverse(reference.T_camera_world))
        if found is None:
            return False
        for away_px in (AWAY_PX, -AWAY_PX):
            again = self._track(frame, first_map, se3.exp(away_px * found.weakest_motion) @ found.T_frame_reference)
            if again is None or image_distance(found, again, reference) > SAME_PX:
                return False
        return True

    def _track(self, frame: Frame, first_map: MapSnapshot, T_frame_reference: np.ndarray) -> Optional[TrackedFrame]:
        return self._tracker.track(
            frame.image_slot, frame.exposure, first_map.reference, [T_frame_reference], np.zeros(2), np.inf
        )


def image_distance(one: TrackedFrame, other: TrackedFrame, reference: TrackingReference) -> float:
    """Root mean square distance in pixels of what two poses show at the same places of the image."""
    cx, cy = reference.intrinsics[2:]
    u, v = (
        grid.ravel().astype(np.float32)
        for grid in np.meshgrid(np.linspace(0, 2 * cx, GRID), np.linspace(0, 2 * cy, GRID))
    )
    idepth = np.full(u.size, np.median(reference.levels[0].idepth), np.float32)
    T_other_one = other.T_frame_reference @ se3.inverse(one.T_frame_reference)
    return float(np.sqrt(mean_squared_flow(u, v, idepth, reference.intrinsics, T_other_one)[1]))
