# SPDX-License-Identifier: BSD-3-Clause
"""Adds keyframes and the wheels' motion to the graph, and detects slip and jumps of the scale."""

import math
from collections import deque
from dataclasses import replace
from typing import Deque, List, Optional, Sequence

import numpy as np

from ceiling_dso_ros.dso.durations import LONG_AGO_NS
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.status import KeyframeEstimate, OdometryStatus
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.ceiling_height import CeilingHeight
from ceiling_dso_ros.fusion.config import FusionConfig, RobotModel
from ceiling_dso_ros.fusion.doubts import Doubts
from ceiling_dso_ros.fusion.graph import GraphEstimate, Interval, WindowGraph
from ceiling_dso_ros.fusion.keyframes import KeyframeChain
from ceiling_dso_ros.fusion.leaving import LeavingKeyframe, LeavingKeyframes
from ceiling_dso_ros.fusion.metre import usable_scale
from ceiling_dso_ros.fusion.motion import MOTION
from ceiling_dso_ros.fusion.slip import SlipMonitor
from ceiling_dso_ros.fusion.smoothing import SmoothedNode, smooth
from ceiling_dso_ros.fusion.state import ScaleState
from ceiling_dso_ros.fusion.taken_back import TakenBack
from ceiling_dso_ros.fusion.visual import VisualMotion
from ceiling_dso_ros.fusion.wheel_bias import WheelBias
from ceiling_dso_ros.fusion.wheel_motion import WheelMotion, WheelNoise
from ceiling_dso_ros.fusion.wheel_track import WheelTrack

MOST_REFINED = 100  # keyframes in a window of the odometry


class KeyframeBackend:
    """Feeds the graph with keyframes.

    Attributes:
        estimate: the graph's estimate at the newest keyframe; None before the first.
        scale_known: the scale of the newest segment is known now.
        scale_was_known: it has been known at any time.
        jump_ns: when the last jump of the visual scale was noticed, nanoseconds on the wheels' clock.
        off_floor: the newest camera motion is not possible on a floor and was not used.
        monitor: the slips.
    """

    def __init__(self, robot: RobotModel, config: FusionConfig, noise: WheelNoise, keep_history: bool) -> None:
        self._T_base_camera = robot.T_base_camera
        self._config = config
        self._noise = noise
        self._graph = WindowGraph(config, noise, keep_history)
        self._chain = KeyframeChain()
        self._leaving = LeavingKeyframes(self._graph, self._chain, config.visual)
        self._left: Deque[LeavingKeyframe] = deque(maxlen=MOST_REFINED)
        self._bias = WheelBias(noise, config.visual)
        self._refused: Deque[int] = deque(maxlen=MOST_REFINED)  # nodes to which the camera's motion is not used
        self.monitor = SlipMonitor(config, noise)
        self._doubts = Doubts(self._graph, self.monitor)
        self._taken_back = TakenBack(self.monitor)
        self._height = CeilingHeight()
        self.estimate: Optional[GraphEstimate] = None
        self.scale_known = False
        self.scale_was_known = False
        self.jump_ns = LONG_AGO_NS
        self.off_floor = False

    @property
    def wheels_slip(self) -> bool:
        """Whether the wheels contradict the camera up to the newest keyframe."""
        return bool(self._graph.intervals) and self._graph.intervals[-1].wheels_slip

    @property
    def newest_ns(self) -> int:
        """Stamp of the newest keyframe in the graph."""
        return self._graph.intervals[-1].stamp_ns if self._graph.intervals else LONG_AGO_NS

    @property
    def segment(self) -> int:
        """Segment of the newest keyframe in the graph, -1 before the first."""
        return self._chain.segment

    @property
    def scale(self) -> ScaleState:
        """The scale of the newest segment; its sigma includes the error of the mean wheel radius."""
        if self.estimate is None:
            return ScaleState(math.nan, math.nan, False, -1)
        sigma = math.hypot(self.estimate.scale_sigma, self._config.wheels.radius_sigma)
        return ScaleState(math.exp(self.estimate.log_scale), sigma, self.scale_known, self.segment)

    @property
    def log_scale_sigma(self) -> float:
        """Standard deviation of the newest segment's log-scale in the graph, inf before the first keyframe."""
        return math.inf if self.estimate is None else self.estimate.scale_sigma

    def mount_camera(self, T_base_camera: np.ndarray) -> None:
        """Set the (4, 4) pose of the camera in the base, before the first keyframe."""
        self._T_base_camera = T_base_camera

    def refine(self, keyframes: Sequence[KeyframeEstimate]) -> List[KeyframeEstimate]:
        """Take in the window of the visual odometry, if it changed; returns the keyframes that are new in it."""
        if not keyframes:
            return []
        self._leaving.refine(keyframes)
        new = self._chain.update(keyframes)
        self._leaving.refined(keyframes)
        for refined in self._chain.refinements():
            stereo = usable_scale(refined.keyframe)
            if stereo is not None:
                self._graph.revise(refined.node, stereo=stereo)
            visual = self._on_floor(refined.T_before_node, refined.covariance)
            if visual is not None and refined.node not in self._refused:
                self._graph.revise(refined.node, visual=visual)
        return new

    def add(
        self,
        keyframe: KeyframeEstimate,
        stamp_ns: int,
        track: WheelTrack,
        covariance: Optional[np.ndarray] = None,
        use_camera: bool = True,
    ) -> Optional[GraphEstimate]:
        """Make a new keyframe a node.

        Args:
            keyframe: one of those that `refine` has returned, in their order.
            stamp_ns: of its image, on the wheels' clock.
            track: the wheel steps; they reach beyond the stamp.
            covariance: (6, 6) of the image's pose as it was tracked, as in OdometryStatus; None where it is unknown.
            use_camera: False where its motion since the last keyframe is doubted.

        Returns:
            The graph's estimate at the new node; None if the wheels' motion up to it is no longer stored, so that it
            cannot become a node.
        """
        wheels = track.since_mark(stamp_ns)
        if wheels is None:
            return None
        visual, end = self._motion_to(keyframe, covariance), self._graph.newest + 1
        continues = self._chain.continues(keyframe)
        log_scale = math.nan if continues else self._height.log_scale(keyframe.depth)
        stereo = usable_scale(keyframe)
        measured = Interval(
            end, stamp_ns, wheels, visual, continues, depth=keyframe.depth, log_scale=log_scale, stereo=stereo
        )
        if not continues:
            self._doubts.forget()
            self._height.begin_segment()
        interval = self._judged(measured) if use_camera else self._without_camera(measured)
        self._append(interval, track)
        self._chain.link(interval.end, keyframe, covariance=covariance)
        self._withdraw_taken_back(interval)
        self._mend_steady_error(interval)
        self.estimate = self._estimate()
        self._height.see(self.estimate.log_scale, interval.depth, abs(float(interval.wheels.pose[0])))
        self._judge_scale(self.estimate.scale_sigma)
        if self._doubts and self.scale_known:
            self._doubts.resolve(math.exp(self.estimate.log_scale))
            self.estimate = self._estimate()
        self._left.extend(self._leaving.solved(self.segment, self.scale_known, stamp_ns))
        return self.estimate

    def doubt_camera(self, since_ns: int) -> None:
        """Withdraw the camera's motions to the keyframes since then, and the slips that they told."""
        doubted = [interval for interval in self._graph.intervals if interval.stamp_ns > since_ns]
        for each in doubted:
            self._graph.revise(each.end, visual=None, wheels_slip=False, doubt=self._without_camera(each).doubt)
        if self.estimate is not None and doubted:
            self.monitor.forget(since_ns)
            self.estimate = self._estimate()

    def begin(self, status: OdometryStatus, stamp_ns: int, track: WheelTrack) -> None:
        """Make a tracked image the first node, if its keyframe is older than the first wheel sample.

        This happens if the fusion starts while the robot stands still: it may take long until the next keyframe.

        Args:
            status: of the image.
            stamp_ns: of the image, on the wheels' clock.
            track: the wheel steps; they reach beyond the stamp.
        """
        wheels, keyframe = track.since_mark(stamp_ns), self._chain.known(status.keyframe_id)
        if wheels is None or keyframe is None:
            return
        interval = Interval(self._graph.newest + 1, stamp_ns, wheels)
        self._append(interval, track)
        self._chain.link(interval.end, keyframe, status.T_keyframe_camera, status.relative_covariance)
        self.estimate = self._estimate()
        self._judge_scale(self.estimate.scale_sigma)

    def _append(self, interval: Interval, track: WheelTrack) -> None:
        self._bias.learn(interval)
        self._graph.add(self._bridged(interval, track))
        track.mark(interval.stamp_ns, self._bias.constants)

    def motion_of(self, status: OdometryStatus) -> Optional[VisualMotion]:
        """Motion of the camera from the newest node to a tracked image; None when they cannot be related."""
        T = self._chain.from_newest(status.keyframe_id, status.T_keyframe_camera)
        return self._on_floor(T, status.relative_covariance)

    def motion_between(self, before: OdometryStatus, after: OdometryStatus) -> Optional[VisualMotion]:
        """Motion of the camera between two tracked images, with both errors; None when they cannot be related."""
        first = self._chain.from_newest(before.keyframe_id, before.T_keyframe_camera)
        second = self._chain.from_newest(after.keyframe_id, after.T_keyframe_camera)
        if first is None or second is None:
            return None
        visual = self._on_floor(se3.inverse(first) @ second, after.relative_covariance)
        start = self._on_floor(np.eye(4), before.relative_covariance)
        return None if visual is None else visual.with_start(start)

    def wheels_contradict(self, wheels: WheelMotion, visual: VisualMotion) -> bool:
        """Whether the wheels slip between two images of the newest segment."""
        if self.estimate is None:
            return False
        scale = math.exp(self.estimate.log_scale)
        found = self.monitor.compare(wheels, visual, scale, self.estimate.scale_sigma)
        return self.monitor.images_contradict(found, self.scale_known)

    def smoothed(self, origin: np.ndarray) -> List[SmoothedNode]:
        """All keyframes as the graph of the whole recording estimates them, relative to (3,) origin.

        Raises:
            RuntimeError: the history was not kept.
        """
        if self._graph.history is None:
            raise RuntimeError("the fusion was not told to keep the history")
        nodes = smooth(np.array([*self._graph.history, *self._graph.motions()], MOTION), self._config)
        return [replace(node, pose=planar.compose(origin, node.pose)) for node in nodes]

    def take_settled(self) -> List[np.ndarray]:
        """Take out what has left the window, each MOTION; who takes it keeps it elsewhere, so that memory is bounded.

        Raises:
            RuntimeError: the history was not kept.
        """
        if self._graph.history is None:
            raise RuntimeError("the fusion was not told to keep the history")
        settled, self._graph.history = self._graph.history, []
        return settled

    def unsettled(self) -> List[np.ndarray]:
        """What the keyframes of the window have measured so far, each MOTION: it follows what was taken last."""
        return self._graph.motions()

    def take_left(self) -> List[LeavingKeyframe]:
        """Take out the newest of the keyframes that have left the odometry's window since the last call."""
        left = list(self._left)
        self._left.clear()
        return left

    def _motion_to(self, keyframe: KeyframeEstimate, covariance: Optional[np.ndarray]) -> Optional[VisualMotion]:
        T = self._chain.motion_to(keyframe)
        visual = self._on_floor(T, covariance)
        self.off_floor = T is not None and visual is None
        return visual

    def _on_floor(self, T: Optional[np.ndarray], covariance: Optional[np.ndarray]) -> Optional[VisualMotion]:
        """The camera's motion, with the covariance of its end, if it is possible for a robot on a floor, else None."""
        if T is None:
            return None
        visual = VisualMotion.from_camera(T, self._T_base_camera, covariance)
        scale = math.exp(self.estimate.log_scale) if self.scale_known and self.estimate is not None else None
        return visual if visual.is_possible(scale, self._config.visual) else None

    def _judged(self, interval: Interval) -> Interval:
        """The interval with the result of the slip test.

        A map that was begun in place of a lost one may be wrong, as that of a cover or of a few lamps. Until its scale
        is known, it has not agreed with the wheels for long enough: if it contradicts them, it is not used. As it may
        be right all the same, and the wheels slip or are stuck, their noise covers what it tells.
        """
        self._doubts.camera_is_used()
        if interval.visual is None or self.estimate is None:
            return interval
        scale = math.exp(self.estimate.log_scale)
        seen = interval.visual.with_start(self._graph.intervals[-1].visual if self._graph.intervals else None)
        found = self.monitor.compare(interval.wheels, seen, scale, self.estimate.scale_sigma)
        known = self.scale_known and interval.continues
        if self.scale_was_known and not known and self.monitor.beyond_gate(found, scale_known=False):
            self._refused.append(interval.end)
            return self._doubts.refused(interval, scale)
        slips = self.monitor.slips(interval, found, known)
        if slips and interval.end - 1 not in self._refused:  # else the camera was not blind before
            self._doubts.suspect_before(interval, scale)
        return replace(interval, wheels_slip=slips)

    def _without_camera(self, interval: Interval) -> Interval:
        """The interval by the wheels, where the camera may be frozen; their error covers that the robot stood."""
        self._refused.append(interval.end)
        if interval.visual is None or self.estimate is None:
            return replace(interval, visual=None)
        return self._doubts.stood_or_drove(interval, math.exp(self.estimate.log_scale))

    def _bridged(self, interval: Interval, track: WheelTrack) -> Interval:
        """An interval without camera: the wheels' motion, corrected by `WheelBias`."""
        if interval.visual is not None or self._config.graph.estimate_wheels:
            return interval
        return replace(interval, wheels=self._bias.bridge(track.corrected_since_mark(interval.stamp_ns)))

    def _withdraw_taken_back(self, newest: Interval) -> None:
        """Where the camera takes back what looked like slips, use the wheels alone."""
        if self.estimate is None or not self.scale_known:
            return
        scale = math.exp(self.estimate.log_scale)
        taken_back = self._taken_back.see(newest, scale, self.estimate.scale_sigma)
        for interval in taken_back:
            self._refused.append(interval.end)
            self._graph.revise(interval.end, visual=None, wheels_slip=False, doubt=None)
        if taken_back:
            self.monitor.forget(taken_back[0].wheels.start_ns)

    def _mend_steady_error(self, newest: Interval) -> None:
        """After a jump of the scale: start a new one there, and withdraw the slips reported since.

        If the wheels have been slipping steadily instead, do not trust them since then.
        """
        error = self.monitor.steady_error()
        if error is None:
            return
        if error.of_scale:
            self.jump_ns = newest.stamp_ns
            self._graph.revise(error.start, continues=False)
            if error.doubt_m > 0.0:  # the camera's motion, with a scale of its own, would leave no room for it
                self._refused.append(error.start)
                self._height.forget()
                self._graph.revise(error.start, visual=None, doubt=np.array([error.doubt_m, error.doubt_m, 0.0]))
            self.monitor.forget(next(i.wheels.start_ns for i in self._graph.intervals if i.end == error.start))
        for interval in [each for each in self._graph.intervals if each.end >= error.start]:
            self._graph.revise(interval.end, wheels_slip=not error.of_scale)
            if not error.of_scale:
                self.monitor.report(interval)

    def _estimate(self) -> GraphEstimate:
        """The graph's estimate; its wheel constants are those of `WheelBias` unless the graph estimates them."""
        estimate = self._graph.optimize()
        if self._config.graph.estimate_wheels:
            return estimate
        return replace(estimate, constants=self._bias.constants, constants_covariance=self._bias.covariance)

    def _judge_scale(self, sigma: float) -> None:
        """The scale is known below one sigma and unknown above another; in between the state does not change.

        That of a new map is only known once the ceiling is as high as before, or after a longer way.
        """
        config = self._config.scale
        is_certain = sigma < config.converged_sigma and (self.scale_known or self._height.agrees)
        self.scale_known = is_certain or (self.scale_known and sigma < config.lost_sigma)
        self.scale_was_known |= self.scale_known
        if self.scale_known:
            self._height.believe()
