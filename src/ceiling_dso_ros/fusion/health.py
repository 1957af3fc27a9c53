# SPDX-License-Identifier: BSD-3-Clause
"""Determines which sensor is missing or faulty, and why."""

from collections import deque
from typing import Deque, Optional, Tuple

from ceiling_dso_ros.dso.durations import LONG_AGO_NS, seconds
from ceiling_dso_ros.dso.status import OdometryStatus, TrackingState
from ceiling_dso_ros.fusion.backend import KeyframeBackend
from ceiling_dso_ros.fusion.config import FusionConfig
from ceiling_dso_ros.fusion.contradiction import Contradiction
from ceiling_dso_ros.fusion.state import FusionState
from ceiling_dso_ros.fusion.wheel_motion import WheelStep

SHOWN_S = 0.5  # a slip, a jump of the scale or a restarted counter stays in the reasons for this time
MISSING = 3  # so many usual intervals without a sample are a silence, too: some robots count slowly
BRIEF_S = 0.25  # images without a pose for no longer than this, such as a flash, are no reason


class Health:
    """Stores when the last data of each sensor arrived, and its state."""

    def __init__(self, config: FusionConfig) -> None:
        self._config = config
        self._wheels_ns = LONG_AGO_NS
        self._restarted_ns = LONG_AGO_NS
        self._camera_ns = self._pose_ns = LONG_AGO_NS
        self._camera: Optional[OdometryStatus] = None
        self._intervals_s: Deque[float] = deque(maxlen=3)  # between wheel samples; the shortest is the usual one

    def heard_wheels(self, step: WheelStep) -> None:
        """Take note of a wheel step."""
        self._wheels_ns = step.end_ns
        self._intervals_s.append(step.duration_s)
        if not step.known:
            self._restarted_ns = step.end_ns

    def heard_camera(self, stamp_ns: int, status: OdometryStatus) -> None:
        """Take note of an image, stamped on the wheels' clock."""
        self._camera_ns = max(stamp_ns, self._camera_ns)
        self._camera = status
        if status.state is TrackingState.TRACKING:
            self._pose_ns = self._camera_ns

    def wheels_silent(self, now_ns: int) -> bool:
        """No wheel sample for too long."""
        usual_s = min(self._intervals_s, default=0.0)
        return seconds(now_ns - self._wheels_ns) > max(self._config.wheels.silence_s, MISSING * usual_s)

    def judge(
        self, now_ns: int, backend: KeyframeBackend, contradiction: Contradiction, late_s: float
    ) -> Tuple[FusionState, Tuple[str, ...]]:
        """The state at a time, and the reasons why it is not CONVERGED; late_s: see `StampShift.late_s`."""
        wheels, eyes = self._wheels(now_ns, backend, contradiction), self._eyes(now_ns, contradiction, late_s)
        reasons = tuple(reason for reason in (wheels, eyes, _scale(now_ns, backend)) if reason)
        if not backend.scale_was_known:
            return FusionState.NOT_SCALED, reasons
        return (FusionState.DEGRADED if reasons else FusionState.CONVERGED), reasons

    def _wheels(self, now_ns: int, backend: KeyframeBackend, contradiction: Contradiction) -> str:
        if self.wheels_silent(now_ns):
            return f"wheels: silent for {seconds(now_ns - self._wheels_ns):.1f} s"
        if seconds(now_ns - self._restarted_ns) < SHOWN_S:
            return "wheels: counters restarted"
        reports = backend.monitor.reports
        reported = bool(reports) and seconds(now_ns - reports[-1].end_ns) < SHOWN_S
        lasts = contradiction.lasts(now_ns) and not contradiction.camera_doubted
        return "wheels: slip" if reported or lasts else ""

    def _eyes(self, now_ns: int, contradiction: Contradiction, late_s: float) -> str:
        if self._camera is None:
            return "camera: no image yet"
        if seconds(now_ns - self._camera_ns) > self._config.visual.silence_s:
            return f"camera: silent for {seconds(now_ns - self._camera_ns):.1f} s"
        if contradiction.camera_doubted:
            return "camera: not used, it has shown a robot that stands while the wheels turned"
        brief = self._camera.state is TrackingState.RETRYING and seconds(now_ns - self._pose_ns) < BRIEF_S
        if self._camera.state is not TrackingState.TRACKING and not brief:
            detail = f" ({self._camera.message})" if self._camera.message else ""
            return f"camera: {self._camera.state.value}{detail}"
        if late_s:
            order = "late" if late_s > 0.0 else "early"
            return f"camera: its stamps are {abs(late_s):.2f} s {order} beside the wheels', by when both turn"
        return ""


def _scale(now_ns: int, backend: KeyframeBackend) -> str:
    if backend.off_floor:
        return "camera: motion impossible for a robot on a floor"
    if seconds(now_ns - backend.jump_ns) < SHOWN_S:
        return "scale: jumped"
    if backend.scale_known:
        return ""
    return f"scale: of segment {backend.segment} not known yet" if backend.scale_was_known else "scale: not known yet"
