# SPDX-License-Identifier: BSD-3-Clause
"""Decides whether a first map is accepted. No pose was published yet, so starting again costs little."""

from typing import Optional

import numpy as np

from ceiling_dso_ros.dso.config import OdometryConfig
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.images.frame import Frame
from ceiling_dso_ros.dso.images.selection import PixelSelector
from ceiling_dso_ros.dso.mapping.map_snapshot import MapSnapshot
from ceiling_dso_ros.dso.tracking.frame_tracker import FrameTracker
from ceiling_dso_ros.dso.tracking.uncertainty import noise_gradient2


class FirstMapCheck:
    """Accepts or rejects first maps."""

    def __init__(self, config: OdometryConfig, tracker: FrameTracker, selector: PixelSelector) -> None:
        self._config = config.initialization
        self._min_points = config.initialization.min_share * config.window.active_points
        self._tracker = tracker
        self._selector = selector

    def fault(self, first_map: MapSnapshot, first: Frame, newest: Frame) -> Optional[str]:
        """Why a map made from two frames is rejected, in words; None if it is accepted."""
        if first_map.rmse > self._config.max_rmse:
            return f"does not explain the images ({first_map.rmse:.1f} grey levels)"
        if first_map.active_points < self._min_points:
            return f"has {first_map.active_points} points only"
        if not self._is_textured(first_map, first, newest):
            return "has too little texture: noise could have made it"
        return None

    def _is_textured(self, first_map: MapSnapshot, first: Frame, newest: Frame) -> bool:
        """Whether the first frame matches its map with enough texture, and not only with the few points of one lamp."""
        reference = first_map.reference
        T_first_reference = se3.inverse(reference.T_camera_world @ first_map.keyframes[0].T_world_camera)
        found = self._tracker.track(
            first.image_slot, first.exposure, reference, [T_first_reference], np.zeros(2), first_map.rmse
        )
        if found is None or found.weakest < self._config.min_texture:
            return False
        gradient2 = self._selector.gradient2_at(newest.image_slot, reference.levels[0].u, reference.levels[0].v)
        return bool(np.median(gradient2) >= self._config.min_point_texture * noise_gradient2(first_map.rmse))
