# SPDX-License-Identifier: BSD-3-Clause
"""Hands frames to the mapping, which traces them and makes keyframes, at once or beside the tracking."""

from dataclasses import replace
from typing import Dict, List, NamedTuple, Optional

import numpy as np

from ceiling_dso_ros.dso.compute.schedulers import SequentialScheduler
from ceiling_dso_ros.dso.compute.stage_timer import StageTimer
from ceiling_dso_ros.dso.images.frame import Frame
from ceiling_dso_ros.dso.images.pyramid import PyramidPool
from ceiling_dso_ros.dso.mapping.first_map import FirstMap
from ceiling_dso_ros.dso.mapping.map_snapshot import MapSnapshot
from ceiling_dso_ros.dso.mapping.mapper import Mapper

MAX_BACKLOG = 6  # frames that may wait; further ones are not traced


class MappingResult(NamedTuple):
    """Result of the mapping for a frame, with a snapshot if it became a keyframe."""

    timing_ms: Dict[str, float]
    snapshot: Optional[MapSnapshot]


class MappingQueue:
    """Hands the frames of one segment to the mapper, and takes the refined map back.

    Attributes:
        map: the map as it was refined last; None while there is none.
        keyframe_pending: a keyframe was handed over whose refined map has not come back yet.
    """

    def __init__(self, mapper: Mapper, pool: PyramidPool, scheduler: SequentialScheduler) -> None:
        self._mapper = mapper
        self._pool = pool
        self._scheduler = scheduler
        self._news: List[MapSnapshot] = []
        self.map: Optional[MapSnapshot] = None
        self.keyframe_pending = False

    def begin(self, segment: int, first: Frame, first_map: FirstMap, frame: Frame, timer: StageTimer) -> MapSnapshot:
        """Make the two frames of a segment's first map keyframes; returns the refined map.

        Raises:
            TrackingLostError: the bundle adjustment has no solution.
        """
        first_id = self._mapper.next_id
        self._mapper.begin(segment, first, first_map)
        affine = np.array([first_map.log_gain - np.log(frame.exposure / first.exposure), first_map.offset])
        self.hand_over(replace(frame, affine=affine), first_id, first_map.T_frame_first, is_keyframe=True)
        self._scheduler.wait()
        self.take_in(timer)
        assert self.map is not None
        return self.map

    def hand_over(self, frame: Frame, keyframe_id: int, T_frame_keyframe: np.ndarray, is_keyframe: bool) -> None:
        """Let the mapping trace a frame, and make it a keyframe.

        Args:
            frame: its image slot goes to the mapping, too.
            keyframe_id: the keyframe that it was tracked against.
            T_frame_keyframe: (4, 4) its motion from there.
            is_keyframe: whether it becomes a keyframe.
        """
        self.keyframe_pending |= is_keyframe
        if is_keyframe or self._scheduler.backlog < MAX_BACKLOG:
            self._scheduler.submit(lambda: self._map_frame(frame, keyframe_id, T_frame_keyframe, is_keyframe))
        else:
            self._pool.release(frame.image_slot)

    def wait(self) -> None:
        """Return when the mapping has done all that it was handed."""
        self._scheduler.wait()

    def take_in(self, timer: StageTimer) -> bool:
        """Use the finished results of the mapping; returns whether there is a new map.

        Raises:
            TrackingLostError: the bundle adjustment has no solution, or too few points are left.
        """
        before = self.map
        for result in self._scheduler.take_results():
            timer.add(result.timing_ms)
            if result.snapshot is not None:
                self.map = result.snapshot
                self._news.append(result.snapshot)
                self.keyframe_pending = False
        return self.map is not before

    def take_news(self) -> List[MapSnapshot]:
        """The maps since the last call, oldest first."""
        news, self._news = self._news, []
        return news

    def _map_frame(
        self, frame: Frame, keyframe_id: int, T_frame_keyframe: np.ndarray, is_keyframe: bool
    ) -> MappingResult:
        timer = StageTimer()
        # The keyframe may have been refined since the frame was tracked against it.
        frame = replace(frame, T_camera_world=T_frame_keyframe @ self._mapper.pose_of(keyframe_id))
        with timer.stage("trace"):
            self._mapper.trace(frame)
        if is_keyframe:
            return MappingResult(timer.timing_ms, self._mapper.add_keyframe(frame, timer))
        self._pool.release(frame.image_slot)
        return MappingResult(timer.timing_ms, None)
