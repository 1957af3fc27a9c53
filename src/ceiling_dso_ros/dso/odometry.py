"""Direct Sparse Odometry: from images to poses."""

from dataclasses import replace
from typing import Any, Dict, List, Optional, Tuple

import numpy as np

from ceiling_dso_ros.dso import se3
from ceiling_dso_ros.dso.camera import PinholeCamera
from ceiling_dso_ros.dso.config import OdometryConfig
from ceiling_dso_ros.dso.initialization import Initializer
from ceiling_dso_ros.dso.keyframe_policy import needs_keyframe
from ceiling_dso_ros.dso.mapping import Frame, Mapper, WindowLostError
from ceiling_dso_ros.dso.pyramid import PyramidPool
from ceiling_dso_ros.dso.selection import PixelSelector
from ceiling_dso_ros.dso.stage_timer import StageTimer
from ceiling_dso_ros.dso.status import OdometryStatus, TrackingState
from ceiling_dso_ros.dso.tracking import FrameTracker, TrackedFrame, motion_hypotheses, pose_covariance
from ceiling_dso_ros.dso.tracking_reference import TrackingReference
from ceiling_dso_ros.dso.window import KeyframeWindow

EXTRA_IMAGES = 3  # beside the window's: the frame in work, the initialiser's first frame, one that is about to leave


class DirectOdometry:
    """Tracks a camera over a stream of images.

    Frames are first collected until there is parallax for a map, then each is tracked against the newest keyframe;
    those that moved enough become keyframes themselves. When tracking fails, the next frame starts a new segment.
    """

    def __init__(self, camera: PinholeCamera, config: OdometryConfig = OdometryConfig()) -> None:
        config.check()
        self.camera = camera
        self.config = config
        self.reset()

    def reset(self) -> None:
        """Forget everything: the next image starts segment 0."""
        self._pool = PyramidPool(self.camera, self.config.window.max_keyframes + 1 + EXTRA_IMAGES)
        self._selector = PixelSelector(self._pool)
        self._tracker = FrameTracker(self._pool, self.config.tracking)
        self._segment = 0
        self._next_keyframe_id = 0
        self._last_pose = np.eye(4)
        self._start_over()

    @property
    def window(self) -> KeyframeWindow:
        """The map as it stands after the last image; read only, and other with the next one."""
        return self._mapper.window

    def track(
        self, image: np.ndarray, stamp_s: float, exposure_ms: Optional[float] = None,
        T_last_camera: Optional[np.ndarray] = None,
    ) -> OdometryStatus:  # fmt: skip
        """Process one image.

        Args:
            image: (height, width) float32 or uint8, undistorted and photometrically corrected, grey levels 0..255.
            stamp_s: seconds, larger than the last one's.
            exposure_ms: exposure time, None or not positive when unknown.
            T_last_camera: (4, 4) pose of this image's camera in the last image's, predicted by other means, translation
                in the unit of the segment; None when there is no prediction.
        """
        self._timer = StageTimer()
        with self._timer.stage("pyramid"):
            frame = self._new_frame(image, stamp_s, exposure_ms)
        if self._reference is None:
            with self._timer.stage("initialize"):
                return self._initialize(frame)
        with self._timer.stage("track"):
            tracked = self._track(frame, T_last_camera)
        if tracked is None:
            return self._lose(frame, "no motion explains this image")
        frame = self._located(frame, tracked)
        with self._timer.stage("trace"):
            self._mapper.trace(frame)
        if self._needs_keyframe(frame, tracked):
            return self._make_keyframe(frame, tracked)
        self._pool.release(frame.image_slot)
        return self._remember(frame, tracked)

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
            return self._without_pose(frame, TrackingState.INITIALIZING, "waiting for parallax")
        self._mapper.begin(self._first, first_map)
        affine = np.array([first_map.log_gain - np.log(frame.exposure / self._first.exposure), first_map.offset])
        T = first_map.T_frame_first @ self._first.T_camera_world
        self._first_rmse = np.inf
        frame = replace(frame, T_camera_world=T, affine=affine)
        self._history = [(self._mapper.window.ids[0], np.eye(4))]
        return self._make_keyframe(frame, None)

    def _start_from(self, frame: Frame, message: str) -> OdometryStatus:
        self._initializer.start(frame.image_slot, self._selector)
        self._first = replace(frame, T_camera_world=se3.inverse(self._last_pose))
        return self._without_pose(frame, TrackingState.INITIALIZING, message)

    # Tracking

    def _track(self, frame: Frame, T_last_camera: Optional[np.ndarray]) -> Optional[TrackedFrame]:
        T_reference_world = self._reference.T_camera_world
        last, previous = (self._mapper.pose_of(keyframe) @ T for keyframe, T in (self._history[-1], self._history[0]))
        T_last_reference = se3.inverse(T_reference_world @ last)
        T_last_previous = se3.inverse(last) @ previous
        hypotheses = motion_hypotheses(T_last_reference, T_last_previous, T_last_camera)
        return self._tracker.track(
            frame.image_slot, frame.exposure, self._reference, hypotheses, self._last_affine, self._last_rmse
        )

    def _located(self, frame: Frame, tracked: TrackedFrame) -> Frame:
        T_camera_world = tracked.T_frame_reference @ self._reference.T_camera_world
        return replace(frame, T_camera_world=T_camera_world, affine=tracked.affine)

    def _lose(self, frame: Frame, reason: str) -> OdometryStatus:
        """Give up the segment; the next image starts another one."""
        self._pool.release_all()
        status = self._without_pose(frame, TrackingState.LOST, reason)
        self._segment += 1
        self._next_keyframe_id = self._mapper.next_id
        self._start_over()
        return status

    # Mapping

    def _needs_keyframe(self, frame: Frame, tracked: TrackedFrame) -> bool:
        if not np.isfinite(self._first_rmse):
            self._first_rmse = tracked.rmse
        diagonal = self.camera.width + self.camera.height
        return needs_keyframe(
            tracked, frame.exposure, self._reference, self._first_rmse, diagonal, self.config.keyframe
        )

    def _make_keyframe(self, frame: Frame, tracked: Optional[TrackedFrame]) -> OdometryStatus:
        try:
            self._reference, estimates = self._mapper.add_keyframe(frame, self._timer)
        except WindowLostError as error:
            return self._lose(frame, str(error))
        self._first_rmse = np.inf
        refined = replace(frame, T_camera_world=self._reference.T_camera_world, affine=self._reference.affine)
        status = self._remember(refined, tracked)
        return replace(status, is_keyframe=True, keyframes=estimates)

    # State

    def _start_over(self) -> None:
        self._initializer = Initializer(self._pool, self.camera.parameters, self.config.initialization)
        self._mapper = Mapper(
            self.camera, self.config, self._pool, self._selector, self._segment, self._next_keyframe_id
        )
        self._reference: Optional[TrackingReference] = None
        self._history: List[Tuple[int, np.ndarray]] = []  # (keyframe, T_keyframe_camera) of the last two frames
        self._last_affine = np.zeros(2)
        self._last_rmse = np.inf

    def _remember(self, frame: Frame, tracked: Optional[TrackedFrame]) -> OdometryStatus:
        T_keyframe_camera = self._reference.T_camera_world @ se3.inverse(frame.T_camera_world)
        self._history = [*self._history[-1:], (self._reference.keyframe_id, T_keyframe_camera)]
        self._last_affine = frame.affine
        self._last_rmse = tracked.rmse if tracked is not None else self._mapper.rmse
        self._last_pose = se3.inverse(frame.T_camera_world)
        return OdometryStatus(
            stamp_s=frame.stamp_s,
            state=TrackingState.TRACKING,
            segment=self._segment,
            T_world_camera=self._last_pose,
            covariance=None if tracked is None else pose_covariance(tracked, frame.T_camera_world),
            keyframe_id=self._reference.keyframe_id,
            T_keyframe_camera=T_keyframe_camera,
            rmse=self._last_rmse,
            **self._counts(),
        )

    def _without_pose(self, frame: Frame, state: TrackingState, message: str) -> OdometryStatus:
        return OdometryStatus(frame.stamp_s, state, self._segment, message=message, **self._counts())

    def _counts(self) -> Dict[str, Any]:
        window = self.window
        return {
            "active_points": window.points.count,
            "candidate_points": window.candidates.count,
            "timing_ms": self._timer.timing_ms,
        }
