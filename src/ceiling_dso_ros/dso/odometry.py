"""Direct Sparse Odometry: from images to poses."""

from contextlib import suppress
from dataclasses import replace
from typing import Any, Dict, List, NamedTuple, Optional, Tuple

import numpy as np

from ceiling_dso_ros.dso.compute.schedulers import SequentialScheduler
from ceiling_dso_ros.dso.compute.stage_timer import StageTimer
from ceiling_dso_ros.dso.config import ConfigError, OdometryConfig
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.dso.geometry.camera_motion import CameraMotion
from ceiling_dso_ros.dso.images.pyramid import PyramidPool, PyramidShape
from ceiling_dso_ros.dso.images.selection import PixelSelector
from ceiling_dso_ros.dso.mapping.keyframe_policy import needs_keyframe
from ceiling_dso_ros.dso.mapping.map_snapshot import MapSnapshot
from ceiling_dso_ros.dso.mapping.mapper import Frame, Mapper, WindowLostError
from ceiling_dso_ros.dso.start.initializer import Initializer
from ceiling_dso_ros.dso.status import OdometryStatus, TrackingState
from ceiling_dso_ros.dso.tracking.frame_tracker import FrameTracker, TrackedFrame, motion_hypotheses
from ceiling_dso_ros.dso.tracking.tracking_reference import TrackingReference
from ceiling_dso_ros.dso.tracking.uncertainty import map_error, noise_gradient2, world_covariance
from ceiling_dso_ros.dso.window.hosted_points import NO_HOSTED_POINTS, HostedPoints

MAX_BACKLOG = 6  # frames that the mapping may have before it; further ones are not traced
# Beside the window's: the frame in work, the initialiser's first frame, one that is about to leave, and the backlog.
EXTRA_IMAGES = 3 + MAX_BACKLOG
MIN_LEVELS = 3  # of the pyramid: pixels are selected on as many


class MappingResult(NamedTuple):
    """What the mapping made of a frame; a snapshot where it became a keyframe."""

    timing_ms: Dict[str, float]
    snapshot: Optional[MapSnapshot]


class DirectOdometry:
    """Tracks a camera over a stream of images.

    Frames are first collected until there is parallax for a map, then each is tracked against the newest keyframe;
    those that moved enough become keyframes themselves. When tracking fails, the next frame starts a new segment.

    With a LiveScheduler the mapping works beside the tracking. The status of an image then does not wait for its
    keyframe: it has the tracked pose, and the refined window comes with the status of a later image.
    """

    def __init__(
        self, camera: PinholeCamera, config: OdometryConfig = OdometryConfig(),
        scheduler: Optional[SequentialScheduler] = None,
    ) -> None:  # fmt: skip
        config.check()
        if PyramidShape.of(camera.width, camera.height).levels < MIN_LEVELS:
            raise ConfigError(
                f"images of {camera.width}x{camera.height} pixels: too small to be tracked, or not divisible by 4; "
                "20000 pixels at least"
            )
        self.camera = camera
        self.config = config
        self._scheduler = SequentialScheduler() if scheduler is None else scheduler
        self.reset()

    def reset(self) -> None:
        """Forget everything: the next image starts segment 0."""
        self._scheduler.discard()
        self._pool = PyramidPool(self.camera, self.config.window.max_keyframes + 1 + EXTRA_IMAGES)
        self._selector = PixelSelector(self._pool)
        self._tracker = FrameTracker(self._pool, self.config.tracking)
        self._segment = 0
        self._next_keyframe_id = 0
        self._last_pose = np.eye(4)
        self._start_over()

    @property
    def map(self) -> Optional[MapSnapshot]:
        """The map as it was refined last; None while a segment has none."""
        return self._map

    def track(
        self, image: np.ndarray, stamp_s: float, exposure_ms: Optional[float] = None,
        prediction: Optional[CameraMotion] = None,
    ) -> OdometryStatus:  # fmt: skip
        """Process one image.

        Args:
            image: (height, width) float32 or uint8, undistorted and photometrically corrected, grey levels 0..255.
            stamp_s: seconds, larger than the last one's.
            exposure_ms: exposure time, None or not positive when unknown.
            prediction: motion from the last image to this one, known by other means; None when there are none.
        """
        self._timer = StageTimer()
        with self._timer.stage("pyramid"):
            frame = self._new_frame(image, stamp_s, exposure_ms)
        try:
            self._take_in_map()
            if self._map is None:
                with self._timer.stage("initialize"):
                    return self._initialize(frame)
            with self._timer.stage("track"):
                tracked = self._track(frame, prediction)
            if tracked is None:
                return self._lose(frame, "no motion explains this image")
            if tracked.weakest < self.config.tracking.min_texture:
                return self._lose(frame, "too little texture: a motion of the camera cannot be told from noise")
            return self._place(replace(frame, affine=tracked.affine), tracked)
        except WindowLostError as error:
            return self._lose(frame, str(error))

    def _new_frame(self, image: np.ndarray, stamp_s: float, exposure_ms: Optional[float]) -> Frame:
        if image.shape != (self.camera.height, self.camera.width):
            raise ValueError(
                f"image of {'x'.join(str(side) for side in image.shape[::-1])} pixels, "
                f"the camera has {self.camera.width}x{self.camera.height}"
            )
        exposure = exposure_ms if exposure_ms is not None and exposure_ms > 0 else 1.0
        return Frame(stamp_s, exposure, self._pool.build(image), np.eye(4), np.zeros(2))

    # The first map

    def _initialize(self, frame: Frame) -> OdometryStatus:
        if not self._initializer.started:
            return self._start_from(frame, "first frame of a segment")
        first_map = self._initializer.add(frame.image_slot, frame.exposure / self._first.exposure)
        if self._initializer.failed:
            self._pool.release(self._first.image_slot)
            return self._start_from(frame, "the first frame led to no map: starting from this one")
        if first_map is None:
            self._pool.release(frame.image_slot)
            return self._without_map(frame, "waiting for parallax")
        first_id = self._mapper.next_id
        self._mapper.begin(self._first, first_map)
        affine = np.array([first_map.log_gain - np.log(frame.exposure / self._first.exposure), first_map.offset])
        self._hand_over(replace(frame, affine=affine), first_id, first_map.T_frame_first, is_keyframe=True)
        self._scheduler.wait()
        self._take_in_map()
        if self._map.rmse > self.config.initialization.max_rmse:
            return self._reject_map(frame, f"does not explain the images ({self._map.rmse:.1f} grey levels)")
        if self._map.active_points < self.config.initialization.min_share * self.config.window.active_points:
            return self._reject_map(frame, f"has {self._map.active_points} points only")
        if not self._is_textured(frame, first_id):
            return self._reject_map(frame, "has too little texture: noise could have made it")
        self._history = [(first_id, np.eye(4))]
        return self._remember(self._refined(frame), self._map.reference, is_keyframe=True)

    def _is_textured(self, frame: Frame, first_id: int) -> bool:
        """Whether the first frame is found again on its map beyond doubt, and not by the few points of one lamp."""
        reference = self._map.reference
        T_first_reference = se3.inverse(reference.T_camera_world @ self._map.pose_of(first_id))
        found = self._tracker.track(
            self._first.image_slot, self._first.exposure, reference, [T_first_reference], np.zeros(2), self._map.rmse
        )
        if found is None or found.weakest < self.config.initialization.min_texture:
            return False
        gradient2 = self._selector.gradient2_at(frame.image_slot, reference.levels[0].u, reference.levels[0].v)
        return np.median(gradient2) >= self.config.initialization.min_point_texture * noise_gradient2(self._map.rmse)

    def _start_from(self, frame: Frame, message: str) -> OdometryStatus:
        self._initializer.start(frame.image_slot, self._selector)
        self._first = replace(frame, T_camera_world=se3.inverse(self._last_pose))
        return self._without_map(frame, message)

    def _reject_map(self, frame: Frame, reason: str) -> OdometryStatus:
        """Try again with the next image as the first one: no pose has been given yet."""
        self._news = []
        status = self._without_map(frame, f"the first map {reason}: starting again")
        self._abandon_map()
        return status

    # Tracking

    def _track(self, frame: Frame, prediction: Optional[CameraMotion]) -> Optional[TrackedFrame]:
        reference = self._map.reference
        last, previous = (self._map.pose_of(keyframe) @ T for keyframe, T in (self._history[-1], self._history[0]))
        T_last_reference = se3.inverse(reference.T_camera_world @ last)
        T_last_previous = se3.inverse(last) @ previous
        hypotheses = motion_hypotheses(T_last_reference, T_last_previous, prediction)
        return self._tracker.track(
            frame.image_slot, frame.exposure, reference, hypotheses, self._last_affine, self._last_rmse
        )

    def _place(self, frame: Frame, tracked: TrackedFrame) -> OdometryStatus:
        """Put a tracked frame into the world and hand it to the mapping."""
        reference = self._map.reference
        is_keyframe = self._needs_keyframe(frame, tracked)
        frame = replace(frame, T_camera_world=tracked.T_frame_reference @ reference.T_camera_world)
        self._hand_over(frame, reference.keyframe_id, tracked.T_frame_reference, is_keyframe)
        self._take_in_map()
        if self._map.stamp_s == frame.stamp_s:
            frame, reference = self._refined(frame), self._map.reference
        return self._remember(frame, reference, is_keyframe, tracked)

    def _lose(self, frame: Frame, reason: str) -> OdometryStatus:
        """Give up the segment; the next image starts another one."""
        self._scheduler.wait()
        with suppress(WindowLostError):
            self._take_in_map()
        status = self._without_pose(frame, TrackingState.LOST, reason)
        self._segment += 1
        self._abandon_map()
        return status

    # Mapping

    def _needs_keyframe(self, frame: Frame, tracked: TrackedFrame) -> bool:
        if self._keyframe_pending:
            return False
        if not np.isfinite(self._first_rmse):
            self._first_rmse = tracked.rmse
        diagonal = self.camera.width + self.camera.height
        return needs_keyframe(
            tracked, frame.exposure, self._map.reference, self._first_rmse, diagonal, self.config.keyframe
        )

    def _hand_over(self, frame: Frame, keyframe_id: int, T_frame_keyframe: np.ndarray, is_keyframe: bool) -> None:
        """Let the mapping trace a frame, and make it a keyframe."""
        self._keyframe_pending |= is_keyframe
        if is_keyframe or self._scheduler.backlog < MAX_BACKLOG:
            self._scheduler.submit(lambda: self._map_frame(frame, keyframe_id, T_frame_keyframe, is_keyframe))
        else:
            self._pool.release(frame.image_slot)

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

    def _take_in_map(self) -> None:
        """Go on with what the mapping has finished.

        Raises:
            WindowLostError: the bundle adjustment has no solution.
        """
        for result in self._scheduler.take_results():
            self._timer.add(result.timing_ms)
            if result.snapshot is not None:
                self._map = result.snapshot
                self._news.append(result.snapshot)
                self._keyframe_pending = False
                self._first_rmse = np.inf

    def _refined(self, frame: Frame) -> Frame:
        reference = self._map.reference
        return replace(frame, T_camera_world=reference.T_camera_world, affine=reference.affine)

    # State

    def _abandon_map(self) -> None:
        self._pool.release_all()
        self._next_keyframe_id = self._mapper.next_id
        self._start_over()

    def _start_over(self) -> None:
        self._initializer = Initializer(self._pool, self.camera.parameters, self.config.initialization)
        self._mapper = Mapper(
            self.camera, self.config, self._pool, self._selector, self._segment, self._next_keyframe_id
        )
        self._map: Optional[MapSnapshot] = None
        self._keyframe_pending = False
        self._news: List[MapSnapshot] = []  # that no status has told of yet
        self._history: List[Tuple[int, np.ndarray]] = []  # (keyframe, T_keyframe_camera) of the last two frames
        self._last_affine = np.zeros(2)
        self._last_rmse = np.inf
        self._first_rmse = np.inf  # of the first frame that was tracked on the newest keyframe

    def _remember(
        self, frame: Frame, reference: TrackingReference, is_keyframe: bool, tracked: Optional[TrackedFrame] = None
    ) -> OdometryStatus:
        T_keyframe_camera = reference.T_camera_world @ se3.inverse(frame.T_camera_world)
        self._history = [*self._history[-1:], (reference.keyframe_id, T_keyframe_camera)]
        self._last_affine = frame.affine
        self._last_rmse = tracked.rmse if tracked is not None else self._map.rmse
        self._last_pose = se3.inverse(frame.T_camera_world)
        return OdometryStatus(
            stamp_s=frame.stamp_s,
            state=TrackingState.TRACKING,
            segment=self._segment,
            T_world_camera=self._last_pose,
            covariance=None if tracked is None else self._covariance(frame, reference, tracked),
            is_keyframe=is_keyframe,
            keyframe_id=reference.keyframe_id,
            T_keyframe_camera=T_keyframe_camera,
            rmse=self._last_rmse,
            **self._common(),
        )

    def _covariance(self, frame: Frame, reference: TrackingReference, tracked: TrackedFrame) -> np.ndarray:
        age = reference.keyframe_id - (self._next_keyframe_id + 1)  # the first map has two keyframes
        return map_error(age) * world_covariance(tracked.covariance, frame.T_camera_world)

    def _without_map(self, frame: Frame, message: str) -> OdometryStatus:
        state = TrackingState.INITIALIZING if self._segment == 0 else TrackingState.RECOVERING
        return self._without_pose(frame, state, message)

    def _without_pose(self, frame: Frame, state: TrackingState, message: str) -> OdometryStatus:
        return OdometryStatus(frame.stamp_s, state, self._segment, message=message, **self._common())

    def _common(self) -> Dict[str, Any]:
        """What every status says."""
        news, self._news = self._news, []
        keyframes = {keyframe.keyframe_id: keyframe for snapshot in news for keyframe in snapshot.keyframes}
        return {
            "keyframes": tuple(keyframes.values()),
            "window_points": news[-1].window_points if news else NO_HOSTED_POINTS,
            "marginalized": HostedPoints.concatenated([snapshot.marginalized for snapshot in news]),
            "active_points": 0 if self._map is None else self._map.active_points,
            "candidate_points": 0 if self._map is None else self._map.candidate_points,
            "timing_ms": self._timer.timing_ms,
        }
