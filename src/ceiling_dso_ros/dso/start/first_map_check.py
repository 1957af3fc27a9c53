# SPDX-License-Identifier: BSD-3-Clause
"""Decides whether a first map is accepted. No pose was published yet, so starting again costs little.

A map of noise, or of one lamp on a bare ceiling, explains its own two images. What it cannot do is to find an image
again: from a start that is moved along the motion that the image determines worst, tracking ends somewhere else.

Where edges have one direction only, depths and a slow tilt explain the images together, and a map that finds every
image may still be wrong. For a camera that moves in a plane, the plane excludes that, and more parallax tells more.
Others need more texture, and begin again with another image.
"""

from typing import NamedTuple, Optional

import numpy as np

from ceiling_dso_ros.dso.config import OdometryConfig
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.images.frame import Frame
from ceiling_dso_ros.dso.images.selection import PixelSelector
from ceiling_dso_ros.dso.mapping.map_snapshot import MapSnapshot
from ceiling_dso_ros.dso.tracking.frame_tracker import FrameTracker, TrackedFrame
from ceiling_dso_ros.dso.tracking.tracking_kernels import mean_squared_flow
from ceiling_dso_ros.dso.tracking.tracking_reference import TrackingReference
from ceiling_dso_ros.dso.tracking.uncertainty import noise_gradient2

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

    def __init__(self, config: OdometryConfig, tracker: FrameTracker, selector: PixelSelector) -> None:
        self._config = config.initialization
        self._selector = selector
        self._min_points = config.initialization.min_share * config.window.active_points
        self._tracker = tracker

    def fault(self, first_map: MapSnapshot, first: Frame, newest: Frame) -> Optional[Fault]:
        """Why a map made from two frames is rejected; None if it is accepted."""
        if first_map.rmse > self._config.max_rmse:
            return Fault(f"does not explain the images ({first_map.rmse:.1f} grey levels)", False)
        if first_map.active_points < self._min_points:
            return Fault(f"has {first_map.active_points} points only", False)
        if not self._finds(first, first_map, newest):
            return Fault("has too little texture: noise could have made it", newest.normal is not None)
        return None

    def _finds(self, frame: Frame, first_map: MapSnapshot, newest: Frame) -> bool:
        """Whether a frame is found in the map with certainty."""
        reference = first_map.reference
        T_frame_reference = se3.inverse(reference.T_camera_world @ first_map.keyframes[0].T_world_camera)
        found = self._track(frame, first_map, T_frame_reference)
        if found is None:
            return False
        if newest.normal is None:
            return found.weakest >= self._config.min_texture and self._is_textured(reference, newest, first_map.rmse)
        return self._is_found_again(frame, first_map, found)

    def _is_textured(self, reference: TrackingReference, newest: Frame, rmse: float) -> bool:
        """Whether the map's points have texture, and not only the few of one lamp."""
        gradient2 = self._selector.gradient2_at(newest.image_slot, reference.levels[0].u, reference.levels[0].v)
        return bool(np.median(gradient2) >= self._config.min_point_texture * noise_gradient2(rmse))

    def _is_found_again(self, frame: Frame, first_map: MapSnapshot, found: TrackedFrame) -> bool:
        """Whether tracking finds the same pose from both sides of it."""
        for away_px in (AWAY_PX, -AWAY_PX):
            again = self._track(frame, first_map, se3.exp(away_px * found.weakest_motion) @ found.T_frame_reference)
            if again is None or image_distance(found, again, first_map.reference) > SAME_PX:
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
