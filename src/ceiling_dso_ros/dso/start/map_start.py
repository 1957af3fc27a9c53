# SPDX-License-Identifier: BSD-3-Clause
"""Collects frames for the first map of a segment."""

from dataclasses import replace
from typing import Collection, NamedTuple, Optional

import numpy as np

from ceiling_dso_ros.dso.config import InitializationConfig
from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.dso.geometry.camera_motion import CameraMotion
from ceiling_dso_ros.dso.images.frame import Frame
from ceiling_dso_ros.dso.images.pyramid import PyramidPool
from ceiling_dso_ros.dso.images.selection import PixelSelector
from ceiling_dso_ros.dso.mapping.first_map import FirstMap
from ceiling_dso_ros.dso.start.initializer import Initializer

MORE_PARALLAX = 1.25  # times that of the last map that was not accepted, until another one is made


class FirstFrames(NamedTuple):
    """The frames that a map begins with.

    Attributes:
        first: the frame whose points have a depth.
        first_map: that depth, and the motion to the newest frame.
    """

    first: Frame
    first_map: FirstMap


class MapStart:
    """Aligns frames to a first one until there is parallax; if that gives no map, another frame becomes the first one.

    Attributes:
        message: what was done with the last frame, in words.
        metres_per_unit: unit of the map, by the motion that other sensors predicted; None where they did not.
    """

    def __init__(
        self, pool: PyramidPool, selector: PixelSelector, camera: PinholeCamera, config: InitializationConfig
    ) -> None:
        self._pool = pool
        self._selector = selector
        self._initializer = Initializer(pool, camera.parameters, config)
        self._first: Optional[Frame] = None
        self.message = ""
        self.metres_per_unit: Optional[float] = None
        self._tried_way = 0.0  # translation in the last map, which was not accepted

    @property
    def first_ns(self) -> Optional[int]:
        """Stamp of the first frame; None before there is one."""
        return None if self._first is None else self._first.stamp_ns

    @property
    def slots(self) -> Collection[int]:
        """Image slots that it needs for the next frames."""
        return () if self._first is None else (self._first.image_slot,)

    def add(
        self, frame: Frame, T_camera_world: np.ndarray, prediction: Optional[CameraMotion] = None
    ) -> Optional[FirstFrames]:
        """Add a frame; takes over its image slot, unless the frame completes the map.

        Args:
            frame: the newest.
            T_camera_world: (4, 4) pose that a first frame gets.
            prediction: motion from the first frame to this one, predicted by other sensors, in any unit.
        """
        if self._first is None:
            self._begin_with(frame, T_camera_world, "first frame of a segment")
            return None
        first_map = self._initializer.add(frame.image_slot, frame.exposure / self._first.exposure, prediction)
        if self._initializer.failed:
            self._pool.release(self._first.image_slot)
            self._begin_with(frame, T_camera_world, "the first frame led to no map: starting from this one")
            return None
        way = 0.0 if first_map is None else float(np.linalg.norm(first_map.T_frame_first[:3, 3]))
        if first_map is None or way < MORE_PARALLAX * self._tried_way:
            self._pool.release(frame.image_slot)
            self.message = "waiting for parallax"
            return None
        if prediction is not None and prediction.metric:
            self.metres_per_unit = float(np.linalg.norm(prediction.T_start_end[:3, 3])) / way or None
        self._tried_way = way
        return FirstFrames(self._first, first_map)

    def _begin_with(self, frame: Frame, T_camera_world: np.ndarray, message: str) -> None:
        self._initializer.start(frame.image_slot, self._selector)
        self._first = replace(frame, T_camera_world=T_camera_world)
        self._tried_way = 0.0
        self.message = message
