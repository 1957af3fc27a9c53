# SPDX-License-Identifier: BSD-3-Clause
"""The whole fusion: it takes wheel samples, keyframes and tracked images, and gives metric poses.

The same class serves the ROS node and the offline run. Wheel and camera data need not arrive in the order of their
stamps: an image is used as soon as a later wheel sample has arrived, a keyframe whenever its optimisation is done.
"""

import bisect
import itertools
from collections import deque
from dataclasses import replace
from typing import Deque, List, Optional, Tuple, Union

import numpy as np

from ceiling_dso_ros.dso.durations import LONG_AGO_NS, nanoseconds, seconds
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.geometry.camera_motion import CameraMotion
from ceiling_dso_ros.dso.status import KeyframeEstimate, OdometryStatus, TrackingState
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.backend import KeyframeBackend
from ceiling_dso_ros.fusion.config import FusionConfig, OutputConfig, RobotModel
from ceiling_dso_ros.fusion.contradiction import Contradiction
from ceiling_dso_ros.fusion.graph import GraphEstimate
from ceiling_dso_ros.fusion.health import Health
from ceiling_dso_ros.fusion.leaps import Leaps
from ceiling_dso_ros.fusion.leaving import LeavingKeyframe
from ceiling_dso_ros.fusion.output import Estimate, LiveOutput, either
from ceiling_dso_ros.fusion.prediction import predict_camera_motion
from ceiling_dso_ros.fusion.seen_motions import SeenMotion, SeenMotions
from ceiling_dso_ros.fusion.slip import SlipReport
from ceiling_dso_ros.fusion.smoothing import SmoothedNode
from ceiling_dso_ros.fusion.stamp_shift import StampShift
from ceiling_dso_ros.fusion.state import FusedState, ScaleState
from ceiling_dso_ros.fusion.wheel import WheelOdometry
from ceiling_dso_ros.fusion.wheel_motion import WheelStep
from ceiling_dso_ros.fusion.wheel_track import HORIZON_S, WheelTrack

NEXT_IMAGE_NS = nanoseconds(0.6)  # images come at least so often, where most are left out, too
LONG_BASELINE_NS = nanoseconds(0.5)  # slow wheels that slip contradict images only over some time
RECENT_FRAMES = 60  # images that are kept to be replayed on a keyframe that comes late
LONGEST_WAIT_NS = nanoseconds(HORIZON_S)  # of camera data for the wheels: what is older cannot be related to them


class FusionEstimator:
    """Fuses the wheels and the visual odometry of one robot.

    Args:
        robot: its geometry.
        config: the settings.
        keep_history: remember every keyframe for `smoothed`; without it the memory does not grow.

    Raises:
        ConfigError: a setting is out of range.
    """

    def __init__(self, robot: RobotModel, config: FusionConfig = FusionConfig(), keep_history: bool = False) -> None:
        config.check()
        se3.adjoint(se3.inverse(np.eye(4)))  # compiled or loaded here, not between two wheel samples
        self.robot = robot
        self._camera_offset_ns = nanoseconds(robot.camera_time_offset_s)
        self.config = config
        self._keep_history = keep_history
        self.reset()

    def reset(self) -> None:
        """Forget everything: the next wheel sample is the origin of odom."""
        self.wheels = WheelOdometry(self.robot, self.config.wheels)
        self._track = WheelTrack(self.wheels.noise)
        self._backend = KeyframeBackend(self.robot, self.config, self.wheels.noise, self._keep_history)
        self._seen = SeenMotions(self._backend, self._track, self.config.visual, self._camera_offset_ns)
        self._health = Health(self.config)
        self._output: Optional[LiveOutput] = None
        self._origin = np.zeros(3)
        self._waiting: List[Tuple[int, int, Union[KeyframeEstimate, OdometryStatus]]] = []
        self._count = itertools.count()
        self._contradiction = Contradiction(self.config.slip)
        self._shift = StampShift()
        self._frames: Deque[OdometryStatus] = deque(maxlen=RECENT_FRAMES)
        self._leaps = Leaps(self.config.output)
        self._held_ns = LONG_AGO_NS  # until then outputs were published that nothing told of a motion
        self._stood: Optional[np.ndarray] = None  # (3,) output, if the camera that is doubted is right
        self._leapt: Optional[OdometryStatus] = None  # the newest image, while no further one has confirmed it
        self._covariances: Deque[Tuple[int, np.ndarray]] = deque(maxlen=RECENT_FRAMES)  # by stamps of images

    def add_wheel_ticks(self, stamp_ns: int, left: int, right: int) -> Optional[FusedState]:
        """Add int32 encoder counters; returns the new output, None for the first sample and for a dropped one."""
        return self._add_step(self.wheels.add_ticks(stamp_ns, left, right))

    def add_wheel_angles(self, stamp_ns: int, left_rad: float, right_rad: float) -> Optional[FusedState]:
        """Add wheel angles; returns as `add_wheel_ticks`."""
        return self._add_step(self.wheels.add_angles(stamp_ns, left_rad, right_rad))

    def add_wheel_odometry(self, stamp_ns: int, pose: np.ndarray) -> Optional[FusedState]:
        """Add the (3,) pose x, y, yaw of the robot's own wheel odometry; returns as `add_wheel_ticks`."""
        return self._add_step(self.wheels.add_pose(stamp_ns, pose))

    def add_keyframes(self, status: OdometryStatus) -> Optional[FusedState]:
        """Add the keyframes as refined with a status; returns an output only while the wheels are silent."""
        if status.relative_covariance is not None:  # the image may be that of one of the keyframes, now or later
            self._covariances.append((status.stamp_ns, status.relative_covariance))
        for keyframe in self._backend.refine(status.keyframes):
            self._wait(keyframe)
        return self._take_in(status)

    def add_frame(self, status: OdometryStatus) -> Optional[FusedState]:
        """Add the pose of a tracked image, or the fact that there is none; returns as `add_keyframes`."""
        self._health.heard_camera(self._on_wheel_clock(status.stamp_ns), status)
        if status.state is TrackingState.TRACKING:
            self._wait(status)
        return self._take_in(status)

    def mount_camera(self, T_base_camera: np.ndarray) -> None:
        """Set the (4, 4) pose of the camera, found while driving, before data of the camera are added.

        Pose and covariance continue: so far the wheels alone have been used.

        Raises:
            ConfigError: it is not a pose of a camera that looks up.
        """
        self.robot = replace(self.robot, T_base_camera=T_base_camera)
        self._backend.mount_camera(T_base_camera)

    def set_pose(self, pose: np.ndarray) -> None:
        """Set the published pose to (3,); later poses continue from there."""
        now = np.zeros(3) if self._output is None else self._output.pose
        self._origin = planar.compose(np.asarray(pose, dtype=float), planar.inverse(now))

    def configure_output(self, output: OutputConfig) -> None:
        """Change the settings of the output from the next output on; the estimate does not change.

        Raises:
            ConfigError: a setting is out of range.
        """
        output.check()
        self.config = replace(self.config, output=output)
        self._leaps.configure(output)
        if self._output is not None:
            self._output.configure(output)

    @property
    def scale(self) -> ScaleState:
        """The scale of the newest keyframe's segment."""
        return self._backend.scale

    @property
    def newest_keyframe(self) -> Optional[GraphEstimate]:
        """The graph's estimate at the newest keyframe, its pose relative to the first wheel sample; None before."""
        return self._backend.estimate

    @property
    def wheel_track(self) -> WheelTrack:
        """The wheels' motion of late."""
        return self._track

    @property
    def slips(self) -> List[SlipReport]:
        """The slips reported so far."""
        return self._backend.monitor.reports

    def predict_camera_motion(self, last: OdometryStatus, end_ns: int) -> Optional[CameraMotion]:
        """Motion of the camera by the wheels to the next image, from the one that the odometry asks for.

        In metres while the odometry has no map, or the scale of its segment is not known. None if that image lies too
        far back.

        Args:
            last: status of the last image.
            end_ns: stamp of the next image, or an earlier one; on the camera's clock.
        """
        if self._track.empty or end_ns <= last.stamp_ns:
            return None
        span_ns = self._on_wheel_clock(last.predict_from_ns), self._on_wheel_clock(end_ns)
        if span_ns[0] < self._track.start_ns:
            return None
        metric = not last.has_map or last.segment != self.scale.segment
        return predict_camera_motion(
            self._track, self.wheels.noise, self.robot.T_base_camera, self._backend.estimate, *span_ns, metric=metric
        )

    def finish(self) -> None:
        """End of the recording: use data that still waits for a wheel sample, such as the last image's keyframe."""
        if self._output is not None:
            self._use_waiting(self._output)

    def smoothed(self) -> List[SmoothedNode]:
        """All keyframes so far as the graph of the whole recording estimates them, in odom; needs keep_history."""
        return self._backend.smoothed(self._origin)

    @property
    def origin(self) -> np.ndarray:
        """(3,) pose of the first wheel sample in odom; `set_pose` changes it."""
        return self._origin

    def take_left(self) -> List[LeavingKeyframe]:
        """Take out the newest of the keyframes that have left the odometry's window since the last call."""
        return self._backend.take_left()

    def take_settled(self) -> List[np.ndarray]:
        """Take out the measurements of the keyframes that are no longer refined, each MOTION; needs keep_history."""
        return self._backend.take_settled()

    def unsettled(self) -> List[np.ndarray]:
        """The measurements of the keyframes that are still refined, each MOTION: they follow those taken last."""
        return self._backend.unsettled()

    def _add_step(self, step: Optional[WheelStep]) -> Optional[FusedState]:
        if step is None:
            return None
        self._health.heard_wheels(step)
        if not self._track.empty:  # nothing is cut off, unless the wheels were silent and have been bridged
            step = step.clip(self._track.end_ns, step.end_ns)
        return None if step is None else self._advance(step)

    def _advance(self, step: WheelStep) -> Optional[FusedState]:
        """Advance by one output: first the wheels, then the images that were waiting for them."""
        if self._output is None:
            self._output = LiveOutput(self.config.output, self.wheels.noise, step.start_ns)
        self._track.add(step)
        slipping = self._contradiction.replaces_wheels(step.end_ns)
        step = self._output.predict(step, slipping, seen=self._sees(step.end_ns))
        self._use_waiting(self._output)
        news = step.clip(self._held_ns, step.end_ns)  # what came before was missing from the last outputs
        return None if news is None else self._state(step.end_ns, *self._output.publish(news))

    def _state(self, stamp_ns: int, pose: Estimate, twist: np.ndarray, twist_covariance: np.ndarray) -> FusedState:
        """An output of `LiveOutput` in odom, with the health."""
        others = self._stood, self._shift.other_pose(pose.pose, twist)
        covariance = sum((either(pose.pose, other) for other in others if other is not None), pose.covariance)
        state, reasons = self._health.judge(stamp_ns, self._backend, self._contradiction, self._shift.late_s)
        in_odom = planar.compose(self._origin, pose.pose), planar.rotate_covariance(covariance, self._origin[2])
        return FusedState(stamp_ns, *in_odom, twist, twist_covariance, state, reasons, self.scale)

    def _sees(self, now_ns: int) -> bool:
        """Whether images have been correcting the output up to now."""
        if not self._frames or not self._backend.scale_known or self._contradiction.camera_doubted:
            return False
        return now_ns - self._on_wheel_clock(self._frames[-1].stamp_ns) < NEXT_IMAGE_NS

    def _use_waiting(self, output: LiveOutput) -> None:
        """Use the camera data whose stamps the wheels have reached by now."""
        while self._waiting and self._waiting[0][0] <= self._track.end_ns:
            stamp_ns, _, item = self._waiting.pop(0)
            if isinstance(item, KeyframeEstimate):
                self._use_keyframe(output, item, stamp_ns)
            else:
                self._use_frame(output, item, stamp_ns)

    def _on_wheel_clock(self, stamp_ns: int) -> int:
        return stamp_ns + self._camera_offset_ns

    def _wait(self, item: Union[KeyframeEstimate, OdometryStatus]) -> None:
        """Keep camera data until a later wheel sample arrives; without any wheel sample so far it is dropped."""
        if not self.wheels.heard:
            return
        stamp_ns = self._on_wheel_clock(item.stamp_ns)
        bisect.insort(self._waiting, (stamp_ns, next(self._count), item))
        while self._waiting[0][0] < stamp_ns - LONGEST_WAIT_NS:
            self._waiting.pop(0)

    def _take_in(self, status: OdometryStatus) -> Optional[FusedState]:
        """While the wheels are silent, continue without them from image to image."""
        now_ns, output = self._on_wheel_clock(status.stamp_ns), self._output
        if output is None or not self._health.wheels_silent(now_ns) or now_ns <= max(self._track.end_ns, self._held_ns):
            return None
        silent_s = seconds(now_ns - self._track.end_ns)
        sees = status.state is TrackingState.TRACKING and self._backend.scale_known
        # What images do not correct is a guess: the robot kept its velocity for a short time.
        forward, turn = (silent_s if sees else min(silent_s, self.config.wheels.silence_s)) * output.twist
        step = WheelStep(self._track.end_ns, now_ns, np.array([forward, 0.0, turn]), known=False)
        if sees:
            return self._advance(step)
        # It is not added to the track: the wheels may still tell what they counted in the meantime.
        goes_on = self._held_ns > self._track.end_ns
        self._held_ns = now_ns
        return self._state(now_ns, *output.hold(step, goes_on))

    def _use_keyframe(self, output: LiveOutput, keyframe: KeyframeEstimate, stamp_ns: int) -> None:
        covariance = next((C for image_ns, C in self._covariances if image_ns == keyframe.stamp_ns), None)
        doubt = self._contradiction
        used = not doubt.camera_doubted or self._seen.moves_again(self._frames, keyframe, doubt.doubted_since_ns)
        estimate = self._backend.add(keyframe, stamp_ns, self._track, covariance, use_camera=used)
        self._stood = None if used else self._stood
        if estimate is not None and (self._backend.scale_was_known or self._backend.wheels_slip):
            self._restart(output, estimate, self._track.end_ns)

    def _restart(self, output: LiveOutput, estimate: GraphEstimate, until_ns: int) -> None:
        """Let the output continue from a keyframe with the wheels since, and with the images up to a stamp."""
        stamps_ns = [self._on_wheel_clock(status.stamp_ns) for status in self._frames]
        sightings = [
            self._seen.sighting(status)
            for status, stamp_ns in zip(self._frames, stamps_ns)
            if estimate.stamp_ns < stamp_ns <= until_ns
        ]
        steps = self._track.steps(estimate.stamp_ns, self._track.end_ns)
        output.restart(estimate, [*steps, *(sighting for sighting in sightings if sighting is not None)])

    def _use_frame(self, output: LiveOutput, status: OdometryStatus, stamp_ns: int) -> None:
        if self._backend.estimate is None:
            self._backend.begin(status, stamp_ns, self._track)
        leapt, self._leapt = self._leapt, None
        further = None if leapt is None else self._seen.between(leapt, status)
        if leapt is not None and self._leaps.confirms(None if further is None else self._seen.speed(further)):
            self._use_image(output, leapt, self._motion_to(leapt))
        seen = self._motion_to(status)
        if seen is not None and self._leaps.leaves_out(self._seen.speed(seen), seen.contradicted):
            self._leapt = status
        else:
            self._use_image(output, status, seen)

    def _motion_to(self, status: OdometryStatus) -> Optional[SeenMotion]:
        """Motion from the last image that was used; None where it tells nothing that the wheels could contradict."""
        if not self._frames or not self._backend.scale_known:
            return None
        return self._seen.between(self._frames[-1], status)

    def _use_image(self, output: LiveOutput, status: OdometryStatus, seen: Optional[SeenMotion]) -> None:
        if seen is not None:
            self._compare_frames(output, status, seen)
        self._frames.append(status)
        sighting = None if self._contradiction.camera_doubted else self._seen.sighting(status)
        if sighting is not None:
            output.correct(sighting)

    def _compare_frames(self, output: LiveOutput, status: OdometryStatus, seen: SeenMotion) -> None:
        """Compare the motion between images with the wheels, which detects slip sooner than that between keyframes."""
        self._shift.add(seen.start_ns, seen.end_ns, seen.visual.yaw, self._track)
        contradiction = self._contradiction
        was_doubted, motion = contradiction.camera_doubted, seen.visual.base_motion(self.scale.value)
        if seen.contradicted:
            contradiction.found(seen.start_ns, seen.end_ns, motion, at_once=True)
            output.withdraw_wheel_twist(seen.start_ns)
        elif self._contradicts_over_long(status):
            contradiction.found(seen.start_ns, seen.end_ns, motion, at_once=False)
        else:
            contradiction.not_found(seen.end_ns, motion)
        if not contradiction.camera_doubted:
            output.correct_twist(self._seen.speed(seen))
        elif not was_doubted and contradiction.since_ns is not None:
            self._stood = output.pose
            self._backend.doubt_camera(contradiction.since_ns)
            if self._backend.estimate is not None:
                self._restart(output, self._backend.estimate, contradiction.since_ns)

    def _contradicts_over_long(self, status: OdometryStatus) -> bool:
        """The same from the oldest image that is not further back than the long baseline."""
        oldest_ns = status.stamp_ns - LONG_BASELINE_NS
        before = next((each for each in self._frames if each.stamp_ns >= oldest_ns), status)
        seen = self._seen.between(before, status)
        return seen is not None and seen.contradicted
