# SPDX-License-Identifier: BSD-3-Clause
"""Direct Sparse Odometry: from images to poses."""

from contextlib import suppress
from dataclasses import replace
from typing import Optional

import numpy as np

from ceiling_dso_ros.dso.compute.schedulers import SequentialScheduler
from ceiling_dso_ros.dso.compute.stage_timer import StageTimer
from ceiling_dso_ros.dso.config import OdometryConfig
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.dso.geometry.camera_motion import CameraMotion
from ceiling_dso_ros.dso.images.exposure_scale import ExposureScale
from ceiling_dso_ros.dso.images.frame import Frame, RightImage
from ceiling_dso_ros.dso.images.noise import noise_level
from ceiling_dso_ros.dso.images.pyramid import PyramidPool, check_trackable
from ceiling_dso_ros.dso.images.selection import PixelSelector
from ceiling_dso_ros.dso.mapping.keyframe_policy import KeyframeTrigger
from ceiling_dso_ros.dso.mapping.map_snapshot import MapSnapshot
from ceiling_dso_ros.dso.mapping.mapper import Mapper
from ceiling_dso_ros.dso.mapping.mapping_queue import MAX_BACKLOG, MappingQueue
from ceiling_dso_ros.dso.mapping.vignetting import VignetteEstimator
from ceiling_dso_ros.dso.segment import Segment
from ceiling_dso_ros.dso.start.first_map_check import FirstMapCheck
from ceiling_dso_ros.dso.start.map_start import MapStart
from ceiling_dso_ros.dso.status import OdometryStatus, TrackingLostError, TrackingState, UntrackedImageError
from ceiling_dso_ros.dso.stereo.rig import StereoRig
from ceiling_dso_ros.dso.tracking.frame_tracker import FrameTracker, TrackedFrame
from ceiling_dso_ros.dso.tracking.track_history import ExpectedMotion

# In addition to the window's: the current frame, the first frame of a map, one that is about to leave, and the backlog.
EXTRA_IMAGES = 3 + MAX_BACKLOG


class DirectOdometry:
    """Tracks a camera over a stream of images.

    Frames are first collected until there is parallax for a map, then each is tracked against the newest keyframe;
    those that moved enough become keyframes themselves. A frame that cannot be tracked has no pose. When there is no
    pose for too long, the next frame starts a new segment.

    With a LiveScheduler the mapping works beside the tracking. The status of an image then does not wait for its
    keyframe: it has the tracked pose, and the refined window comes with the status of a later image.
    """

    def __init__(
        self, camera: PinholeCamera, config: OdometryConfig = OdometryConfig(),
        scheduler: Optional[SequentialScheduler] = None, rig: Optional[StereoRig] = None,
    ) -> None:  # fmt: skip
        """Prepare for images of a camera.

        Args:
            camera: of the images.
            config: all settings.
            scheduler: of the mapping; None for one that does it at once.
            rig: a second camera, which tells the scale of keyframes; None without one.

        Raises:
            ConfigError: a setting is out of range, or images of that size cannot be tracked.
        """
        config.check()
        check_trackable(camera)
        self.camera = camera
        self.config = config
        self._rig = rig
        self._scheduler = SequentialScheduler() if scheduler is None else scheduler
        self.reset()

    def reset(self) -> None:
        """Forget everything: the next image starts segment 0."""
        self._scheduler.discard()
        self._pool = PyramidPool(self.camera, self.config.window.max_keyframes + 1 + EXTRA_IMAGES)
        self._selector = PixelSelector(self._pool)
        self._tracker = FrameTracker(self._pool, self.config.tracking)
        self._exposures = ExposureScale()
        self._vignetting = VignetteEstimator(self.camera, self.config.window.min_keyframes)
        self._normal: Optional[np.ndarray] = None  # of the plane in which the camera moves
        self._first_map_check = FirstMapCheck(self.config, self._tracker, self._selector)
        self._mapper = Mapper(self.camera, self.config, self._pool, self._selector, self._vignetting, self._rig)
        self._segment = self._new_segment(number=0, T_world_camera=np.eye(4))

    @property
    def map(self) -> Optional[MapSnapshot]:
        """The map as it was refined last; None while a segment has none."""
        return self._segment.map

    def track(
        self, image: np.ndarray, stamp_ns: int, exposure_ms: Optional[float] = None,
        prediction: Optional[CameraMotion] = None, right: Optional[RightImage] = None,
    ) -> OdometryStatus:  # fmt: skip
        """Process one image.

        Args:
            image: (height, width) float32 or uint8, undistorted and photometrically corrected, grey levels 0..255.
            stamp_ns: nanoseconds, larger than the last one's.
            exposure_ms: exposure time, None or not positive when unknown.
            prediction: motion to this image from the one that the last status asks for, predicted by other sensors;
                None if there is no prediction.
            right: gives the image of the second camera at this time, (height, width) float32, like this one, or None;
                only called, perhaps by another thread, if the image becomes a keyframe.
        """
        segment, timer = self._segment, StageTimer()
        try:
            segment.catch_up(timer)
            with timer.stage("pyramid"):
                frame = self._new_frame(image, stamp_ns, exposure_ms, prediction, right)
            if segment.map is None:
                with timer.stage("initialize"):
                    return self._initialize(frame, prediction, timer)
            current, reference = segment.map, segment.map.reference
            with timer.stage("track"):
                tracked = self._find(frame, current, segment.in_unit(prediction))
            T_camera_world = tracked.T_frame_reference @ reference.T_camera_world
            frame = replace(frame, T_camera_world=T_camera_world, affine=tracked.affine)
            is_keyframe = segment.needs_keyframe(frame, tracked, reference)
            segment.mapping.hand_over(frame, reference.keyframe_id, tracked.T_frame_reference, is_keyframe)
            segment.take_in_map(timer)
            return segment.status_with_pose(frame, current, tracked, is_keyframe, timer)
        except UntrackedImageError as error:
            return self._set_aside(frame, str(error), timer)
        except TrackingLostError as error:
            return self._lose(stamp_ns, str(error), timer)

    def expect(self, stamp_ns: int, prediction: Optional[CameraMotion] = None) -> Optional[ExpectedMotion]:
        """How the camera should have moved up to an image, before any work on it; None without a map.

        Args:
            stamp_ns: of the image, nanoseconds.
            prediction: as for `track`.
        """
        segment = self._segment
        if segment.map is None:
            return None
        current, history = segment.map, segment.history
        return history.expect(current.reference, current.pose_of, stamp_ns, segment.in_unit(prediction))

    def skip(self, stamp_ns: int, reason: str) -> OdometryStatus:
        """Take note of an image that shows nothing of the motion: it has no pose, and nothing else changes.

        Args:
            stamp_ns: nanoseconds, larger than the last one's.
            reason: what is wrong with the image, in words.
        """
        if self.map is None:
            return self._segment.status_without_map(stamp_ns, reason, StageTimer())
        return self._segment.status_without_pose(stamp_ns, TrackingState.RETRYING, reason, StageTimer())

    def _new_frame(
        self, image: np.ndarray, stamp_ns: int, exposure_ms: Optional[float], prediction: Optional[CameraMotion],
        right: Optional[RightImage],
    ) -> Frame:  # fmt: skip
        if image.shape != (self.camera.height, self.camera.width):
            raise ValueError(
                f"image of {'x'.join(str(side) for side in image.shape[::-1])} pixels, "
                f"the camera has {self.camera.width}x{self.camera.height}"
            )
        segment = self._segment
        if segment.smooth is None:
            noise = noise_level(image)
            segment.smooth = None if noise is None else noise > self.config.images.max_noise
        smooth = bool(segment.smooth)
        vignette = self._vignetting.vignette if segment.map is None else segment.map.vignette
        slot = self._pool.build(image, smooth, vignette)
        if prediction is not None:
            self._normal = prediction.normal
        exposure = self._exposures.of(exposure_ms)
        return Frame(stamp_ns, exposure, slot, np.eye(4), np.zeros(2), self._normal, right, smooth)

    def _initialize(self, frame: Frame, prediction: Optional[CameraMotion], timer: StageTimer) -> OdometryStatus:
        """Collect frames for a first map; there is no pose before the map is accepted."""
        segment = self._segment
        frames = segment.start.add(frame, se3.inverse(segment.T_world_camera), prediction)
        if frames is None:
            return segment.status_without_map(frame.stamp_ns, segment.start.message, timer)
        first_map = segment.begin_map(frames, frame, timer)
        fault = self._first_map_check.fault(first_map, frames.first, frame)
        if fault is None:
            return segment.status_with_pose(frame, first_map, None, True, timer)
        segment.mapping.take_news()
        after = "waiting for more parallax" if fault.more_parallax_helps else "starting again"
        status = segment.status_without_map(frame.stamp_ns, f"the first map {fault.reason}: {after}", timer)
        start = segment.start if fault.more_parallax_helps else None
        self._segment = self._new_segment(segment.number, segment.T_world_camera, start)
        return status

    def _find(self, frame: Frame, current: MapSnapshot, prediction: Optional[CameraMotion]) -> TrackedFrame:
        """Align a frame with the newest keyframe.

        Raises:
            UntrackedImageError: no pose explains the image, noise would explain it as well, or it is another time's.
        """
        history, reference = self._segment.history, current.reference
        seen_before = reference, current.pose_of, frame.stamp_ns, prediction
        hypotheses = history.hypotheses(*seen_before)
        tracked = self._tracker.track(
            frame.image_slot, frame.exposure, reference, hypotheses, history.affine, history.rmse
        )
        if tracked is None:
            raise UntrackedImageError("no motion explains this image")
        if tracked.weakest < self.config.tracking.min_texture:
            raise UntrackedImageError("too little texture: a motion of the camera cannot be told from noise")
        if history.doubts(tracked, *seen_before):
            raise UntrackedImageError("moved too far since the last image: the next one may confirm it")
        return tracked

    def _set_aside(self, frame: Frame, reason: str, timer: StageTimer) -> OdometryStatus:
        """Leave out one frame, as after a flash; give up the segment only when there was no pose for too long."""
        history, patience = self._segment.history, self.config.tracking.patience
        if not history.miss(frame.stamp_ns, patience):
            if history.blind_s > patience:
                reason = f"no image for {history.blind_s:.1f} s, in which the map may have gone out of view; {reason}"
            return self._lose(frame.stamp_ns, reason, timer)
        self._pool.release(frame.image_slot)
        return self._segment.status_without_pose(frame.stamp_ns, TrackingState.RETRYING, reason, timer)

    def _lose(self, stamp_ns: int, reason: str, timer: StageTimer) -> OdometryStatus:
        """Give up the segment; the next image starts another one."""
        segment = self._segment
        self._scheduler.wait()
        with suppress(TrackingLostError):
            segment.take_in_map(timer)
        status = segment.status_without_pose(stamp_ns, TrackingState.LOST, reason, timer)
        self._segment = self._new_segment(segment.number + 1, segment.T_world_camera)
        return status

    def _new_segment(self, number: int, T_world_camera: np.ndarray, start: Optional[MapStart] = None) -> Segment:
        """Begin without a map, and without images but those of a start that goes on."""
        self._scheduler.discard()
        self._pool.release_all(() if start is None else start.slots)
        if start is None:
            start = MapStart(self._pool, self._selector, self.camera, self.config.initialization)
        return Segment(
            number,
            self._mapper.next_id,
            T_world_camera,
            start,
            MappingQueue(self._mapper, self._pool, self._scheduler),
            KeyframeTrigger(self.camera, self.config.keyframe),
        )
