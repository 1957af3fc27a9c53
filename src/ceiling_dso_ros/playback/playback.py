"""Plays a recording through the odometry as fast as it goes, dropping nothing, and writes the results."""

import json
import time
from pathlib import Path
from typing import Any, Callable, Dict, Iterable, List, Optional, Union

from ceiling_dso_ros.dso import DirectOdometry, OdometryStatus, TrackingState
from ceiling_dso_ros.io.interrupts import deferred_interrupt
from ceiling_dso_ros.io.ply import write_ply
from ceiling_dso_ros.io.preprocessing import ImagePreprocessor
from ceiling_dso_ros.io.recording import Frame, SkippedFrame
from ceiling_dso_ros.io.trajectory import write_tum
from ceiling_dso_ros.playback.fusion_playback import FusionPlayback
from ceiling_dso_ros.playback.map_recorder import MapRecorder
from ceiling_dso_ros.playback.timing_log import TimingLog
from ceiling_dso_ros.playback.trajectory_recorder import TrajectoryRecorder


class Playback:
    """One run of the odometry, and of the fusion where there are wheels, over a recording.

    What has been computed can be written at any time, also after `play` was interrupted or failed.

    Attributes:
        trajectories: the poses so far.
        map: the points so far.
        timing: the times so far.
        warnings: what was wrong with skipped frames.
    """

    def __init__(
        self,
        preprocess: ImagePreprocessor,
        odometry: DirectOdometry,
        warn: Callable[[str], None],
        fusion: Optional[FusionPlayback] = None,
        predict: bool = False,
    ) -> None:
        """Take the parts of a run; with `predict` the wheels tell the odometry how the camera has moved."""
        self._preprocess = preprocess
        self._odometry = odometry
        self._warn = warn
        self._fusion = fusion
        self._predict = predict
        self._last: Optional[OdometryStatus] = None
        self.trajectories = TrajectoryRecorder()
        self.map = MapRecorder()
        self.timing = TimingLog()
        self.warnings: List[str] = []

    def play(self, frames: Iterable[Union[Frame, SkippedFrame]]) -> None:
        """Track every frame; whatever the frames or the odometry raise goes through, Ctrl-C between two frames."""
        for frame in frames:
            if isinstance(frame, SkippedFrame):
                self.warnings.append(frame.reason)
                self._warn(frame.reason)
            else:
                with deferred_interrupt():
                    self._track(frame)
        if self._fusion is not None:
            self._fusion.finish()

    def write(self, directory: Path, end: str) -> None:
        """Write all files of a run but its settings.

        Args:
            directory: an existing folder.
            end: how the run ended, for the summary: complete, interrupted, or what failed.

        Raises:
            OSError: a file cannot be written.
        """
        write_tum(directory / "camera.tum", self.trajectories.live())
        write_tum(directory / "camera_final.tum", self.trajectories.final())
        write_tum(directory / "keyframes.tum", self.trajectories.keyframes())
        write_ply(directory / "map.ply", self.map.cloud(self.trajectories.estimates))
        self.timing.write_csv(directory / "timing.csv")
        if self._fusion is not None:
            self._fusion.write(directory)
        summary = json.dumps({**self.summary(), "end": end}, indent=2, allow_nan=False)
        (directory / "summary.json").write_text(summary + "\n")

    def summary(self) -> Dict[str, Any]:
        """Counts, times and warnings, and what the fusion says; with a camera alone the scale stays unknown."""
        unknown = {"scale": {"value": None, "sigma": None, "converged": False}}
        return {
            "frames": len(self.timing),
            "tracked": self.timing.count(TrackingState.TRACKING),
            "lost": self.timing.count(TrackingState.LOST),
            "keyframes": len(self.trajectories.keyframes()),
            "segments": self.trajectories.segments,
            "ms": self.timing.statistics_ms(),
            **(unknown if self._fusion is None else self._fusion.summary()),
            "warnings": self.warnings,
        }

    def _track(self, frame: Frame) -> None:
        start = time.perf_counter()
        image = self._preprocess(frame.image)
        preprocessed = time.perf_counter()
        known = {}
        if self._predict and self._fusion is not None and self._last is not None:
            known["prediction"] = self._fusion.predicted_motion(self._last, frame.stamp_ns)
        status = self._odometry.track(image, frame.stamp_ns, frame.exposure_ms, **known)
        end = time.perf_counter()
        self._last = status
        self.trajectories.add(status)
        self.map.add(status)
        stages_ms = {"undistort": 1e3 * (preprocessed - start), **status.timing_ms}
        self.timing.add(status, 1e3 * (end - start), stages_ms)
        if self._fusion is not None:
            self._fusion.add(status)
