# SPDX-License-Identifier: BSD-3-Clause
"""A segment: a stretch of tracking with a map, and a unit of length, of its own."""

from dataclasses import dataclass, field, replace
from typing import Any, Dict, Optional

import numpy as np

from ceiling_dso_ros.dso.compute.stage_timer import StageTimer
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.geometry.camera_motion import CameraMotion
from ceiling_dso_ros.dso.hosted_points import NO_HOSTED_POINTS, HostedPoints
from ceiling_dso_ros.dso.images.frame import Frame
from ceiling_dso_ros.dso.mapping.keyframe_policy import KeyframeTrigger
from ceiling_dso_ros.dso.mapping.map_snapshot import MapSnapshot
from ceiling_dso_ros.dso.mapping.mapping_queue import MappingQueue
from ceiling_dso_ros.dso.start.map_start import FirstFrames, MapStart
from ceiling_dso_ros.dso.status import OdometryStatus, TrackingState
from ceiling_dso_ros.dso.tracking.frame_tracker import TrackedFrame
from ceiling_dso_ros.dso.tracking.track_history import TrackHistory
from ceiling_dso_ros.dso.tracking.tracking_reference import TrackingReference
from ceiling_dso_ros.dso.tracking.uncertainty import map_error, world_covariance

KEYFRAMES_OF_FIRST_MAP = 2
METRES_PER_UNIT_SIGMA = 0.1  # relative: of the ratio of a motion by other sensors and in the first map


@dataclass
class Segment:
    """State of a segment between images; makes the status of each image.

    Attributes:
        number: counts up from 0 over the run.
        first_keyframe_id: identity of its first keyframe.
        T_world_camera: (4, 4) float64, the last pose; at first that of the segment before.
        start: collects frames until there is a map.
        mapping: has frames traced and made keyframes.
        trigger: decides which frames become keyframes.
        history: the last frames with a pose.
        smooth: its images are smoothed against noise; None before one has shown its noise, which decides.
        ahead_of_map: the last frame should have become a keyframe, but the one before is still being processed.
    """

    number: int
    first_keyframe_id: int
    T_world_camera: np.ndarray
    start: MapStart
    mapping: MappingQueue
    trigger: KeyframeTrigger
    history: TrackHistory = field(default_factory=TrackHistory)
    smooth: Optional[bool] = None
    ahead_of_map: bool = False

    @property
    def map(self) -> Optional[MapSnapshot]:
        """The map as it was refined last; None while there is none."""
        return self.mapping.map

    def in_unit(self, prediction: Optional[CameraMotion]) -> Optional[CameraMotion]:
        """A predicted motion in the segment's unit; None where there is none, or metres cannot be converted."""
        if prediction is None or not prediction.metric:
            return prediction
        metres_per_unit = self.start.metres_per_unit
        return None if metres_per_unit is None else prediction.in_unit(metres_per_unit, METRES_PER_UNIT_SIGMA)

    def begin_map(self, frames: FirstFrames, newest: Frame, timer: StageTimer) -> MapSnapshot:
        """Make the first map.

        Raises:
            TrackingLostError: the bundle adjustment has no solution.
        """
        first_map = self.mapping.begin(self.number, frames.first, frames.first_map, newest, timer)
        self.history.begin(self.first_keyframe_id)
        return first_map

    def catch_up(self, timer: StageTimer) -> None:
        """Use the map as it is before the next frame; the mapping comes first if the tracking has run ahead of it.

        Otherwise images that come all at once would be tracked against a keyframe that is out of their view.

        Raises:
            TrackingLostError: the map has no solution any more.
        """
        if self.ahead_of_map:
            self.mapping.wait()
        self.take_in_map(timer)

    def take_in_map(self, timer: StageTimer) -> None:
        """Use the finished results of the mapping.

        Raises:
            TrackingLostError: the map has no solution any more.
        """
        if self.mapping.take_in(timer):
            self.trigger.renew()

    def needs_keyframe(self, frame: Frame, tracked: TrackedFrame, reference: TrackingReference) -> bool:
        """Whether a tracked frame becomes a keyframe; never while another keyframe is being processed."""
        due = self.trigger.fires(tracked, frame.exposure, reference)
        self.ahead_of_map = due and self.mapping.keyframe_pending
        return due and not self.mapping.keyframe_pending

    def status_with_pose(
        self, frame: Frame, current: MapSnapshot, tracked: Optional[TrackedFrame], is_keyframe: bool, timer: StageTimer
    ) -> OdometryStatus:
        """Store a frame's pose; returns its status.

        Args:
            frame: with its pose and brightness.
            current: the map that the frame was tracked against.
            tracked: result of the tracking; None for the frame that completed the first map.
            is_keyframe: whether it became a keyframe.
            timer: times of the stages.
        """
        rmse = current.rmse if tracked is None else tracked.rmse
        reference, newest = current.reference, self.map
        if newest is not None and newest.stamp_ns == frame.stamp_ns:  # the frame is a keyframe, already refined
            reference = newest.reference
            frame = replace(frame, T_camera_world=reference.T_camera_world, affine=reference.affine)
        T_keyframe_camera = self.history.remember(frame, reference, rmse)
        self.T_world_camera = se3.inverse(frame.T_camera_world)
        # A left increment on T_camera_world is a right one on its inverse.
        covariance = None if tracked is None else self._map_error(reference) * tracked.covariance
        return OdometryStatus(
            stamp_ns=frame.stamp_ns,
            state=TrackingState.TRACKING,
            segment=self.number,
            T_world_camera=self.T_world_camera,
            covariance=None if covariance is None else world_covariance(covariance, frame.T_camera_world),
            is_keyframe=is_keyframe,
            keyframe_id=reference.keyframe_id,
            T_keyframe_camera=T_keyframe_camera,
            relative_covariance=covariance,
            rmse=rmse,
            **self._common(timer),
        )

    def status_without_map(self, stamp_ns: int, message: str, timer: StageTimer) -> OdometryStatus:
        """Status of a frame, stamped in nanoseconds, while there is no map yet; the message says why."""
        state = TrackingState.INITIALIZING if self.number == 0 else TrackingState.RECOVERING
        return self.status_without_pose(stamp_ns, state, message, timer)

    def status_without_pose(
        self, stamp_ns: int, state: TrackingState, message: str, timer: StageTimer
    ) -> OdometryStatus:
        """Status of a frame without a pose; the message says why."""
        earlier_start_ns = None
        if state is TrackingState.RETRYING:
            earlier_start_ns = self.history.last_ns
        elif state is not TrackingState.LOST:  # after that, the next image begins another map
            earlier_start_ns = self.start.first_ns
        return OdometryStatus(
            stamp_ns, state, self.number, message=message, earlier_start_ns=earlier_start_ns, **self._common(timer)
        )

    def _map_error(self, reference: TrackingReference) -> float:
        return map_error(reference.keyframe_id - self.first_keyframe_id - (KEYFRAMES_OF_FIRST_MAP - 1))

    def _common(self, timer: StageTimer) -> Dict[str, Any]:
        """Fields that every status has."""
        news = self.mapping.take_news()
        keyframes = {keyframe.keyframe_id: keyframe for snapshot in news for keyframe in snapshot.keyframes}
        return {
            "keyframes": tuple(keyframes.values()),
            "window_points": news[-1].window_points if news else NO_HOSTED_POINTS,
            "marginalized": HostedPoints.concatenated([snapshot.marginalized for snapshot in news]),
            "active_points": 0 if self.map is None else self.map.active_points,
            "candidate_points": 0 if self.map is None else self.map.candidate_points,
            "timing_ms": timer.timing_ms,
        }
