# SPDX-License-Identifier: BSD-3-Clause
"""Plays a recording through the odometry as fast as possible, without dropping images, and writes the results."""

import json
from pathlib import Path
from typing import Any, Callable, Dict, Iterable, List, Optional, Tuple, Union

import numpy as np

from ceiling_dso_ros.dso import CameraMotion, OdometryStatus, TrackingState
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.interrupts import deferred_interrupt
from ceiling_dso_ros.io.ply import write_ply
from ceiling_dso_ros.io.recording import Frame, SkippedFrame
from ceiling_dso_ros.io.replacing import replace_file, write_each
from ceiling_dso_ros.io.stamps import format_stamp
from ceiling_dso_ros.io.trajectory import Trajectory, write_tum
from ceiling_dso_ros.io.warning_log import CountedMessages, WarningLog
from ceiling_dso_ros.playback.fusion_playback import OF_FUSION, FusionPlayback
from ceiling_dso_ros.playback.keyframe_recorder import KeyframeRecorder
from ceiling_dso_ros.playback.map_recorder import MapRecorder
from ceiling_dso_ros.playback.metric_camera import metric_camera, scale_summary
from ceiling_dso_ros.playback.timing_log import TimingLog
from ceiling_dso_ros.playback.visual_run import VisualRun
from ceiling_dso_ros.slam.record_maker import NewRecord, RecordMaker

METRIC = "camera_metric.tum"  # where there are two cameras and no wheels
OF_SOME_RUNS = (*OF_FUSION, METRIC)  # files that not every run has


class Playback:
    """One run of the odometry, and of the fusion where there are wheels, over a recording.

    The results so far can be written at any time, also after `play` was interrupted or failed.

    Attributes:
        visual: the images' part, with the poses so far.
        map: the points so far.
        records: what a map of the site needs of the keyframes that have left the window so far, if it is wanted.
        timing: the times so far.
        warnings: what is doubtful in the recording, and the reasons of skipped frames.
        skipped: number of frames skipped so far.
    """

    def __init__(
        self,
        visual: VisualRun,
        warnings: WarningLog,
        fusion: Optional[FusionPlayback] = None,
        predict: bool = True,
        keep_keyframes: bool = False,
        watch: Optional[Callable[[np.ndarray, OdometryStatus], None]] = None,
    ) -> None:
        """Prepare a run.

        Args:
            visual: the images' part.
            warnings: for what is doubtful.
            fusion: the wheels' part.
            predict: the wheels, if there are any, predict the camera's motion for the odometry.
            keep_keyframes: keep what a map of the site needs; with wheels only.
            watch: is given each image, (height, width) float32 and undistorted, with its result.
        """
        self.visual = visual
        self._fusion = fusion
        self._predict = predict
        self.map = MapRecorder()
        self._recorder = KeyframeRecorder(visual.preprocess.camera) if keep_keyframes else None
        self._watch = watch
        self._maker = RecordMaker()
        self.records: List[NewRecord] = []
        self.timing = TimingLog()
        self.warnings = warnings
        self.skipped = 0
        self._untracked = CountedMessages()

    def play(self, frames: Iterable[Union[Frame, SkippedFrame]]) -> None:
        """Track every frame. Exceptions are not caught; Ctrl-C takes effect between two frames.

        Raises:
            InputError: not one frame can be used.
        """
        before_the_first: List[SkippedFrame] = []  # warned of when it is clear that there is more to say
        for frame in frames:
            if isinstance(frame, SkippedFrame):
                self.skipped += 1
                if not len(self.timing):
                    before_the_first.append(frame)
                else:
                    self.warnings.add(frame.reason, frame.kind)
                continue
            while before_the_first:
                skipped = before_the_first.pop(0)
                self.warnings.add(skipped.reason, skipped.kind)
            with deferred_interrupt():
                self._track(frame)
        if not len(self.timing):
            if not before_the_first:
                raise InputError("there are no images")
            raise InputError(f"none of the {self.skipped} images can be used; the first: {before_the_first[0].reason}")
        if self._fusion is not None:
            self._fusion.finish()
            self._make_records(self._fusion)

    def leaves_out(self, stamp_ns: int) -> bool:
        """Whether not to play the next image, stamped in nanoseconds; see `VisualRun.leaves_out`."""
        if self.visual.regulation is None:
            return False
        return self.visual.leaves_out(stamp_ns, self._prediction(stamp_ns))

    def write(self, directory: Path, end: str) -> None:
        """Write all files of a run except its settings.

        Args:
            directory: an existing folder.
            end: how the run ended, for the summary: complete, interrupted, or what failed.

        Raises:
            OutputError: some files cannot be written; all the others are.
        """
        write_each(directory, self._writers(end))

    @property
    def files(self) -> List[str]:
        """Names of the files that `write` writes."""
        return list(self._writers(""))

    def summary(self) -> Dict[str, Any]:
        """Counts, times and warnings, and what the fusion says; with one camera alone the scale stays unknown."""
        alone = {"scale": scale_summary(self.visual.trajectories)}
        return {
            "frames": len(self.timing),
            "tracked": self.timing.count(TrackingState.TRACKING),
            "lost": self.timing.count(TrackingState.LOST),
            "keyframes": len(self.visual.trajectories.keyframes()),
            "skipped": self.skipped,
            "segments": self.visual.trajectories.segments,
            **({} if self.visual.regulation is None else {"frame_rate": self.visual.regulation.summary()}),
            "ms": self.timing.statistics_ms(),
            **(alone if self._fusion is None else self._fusion.summary()),
            "warnings": self.warnings.lines,
        }

    def why_untracked(self) -> Tuple[str, int]:
        """The most frequent reason why an image has no pose, and of how many images; ("", 0) if all have one."""
        return self._untracked.most_frequent()

    def _writers(self, end: str) -> Dict[str, Callable[[Path], None]]:
        """Name of each file -> what writes it."""
        trajectories = {**self.visual.trajectories.files(), **({} if self._fusion is None else self._fusion.files())}
        if self._fusion is None and self.visual.has_second_camera:
            trajectories[METRIC] = lambda: metric_camera(self.visual.trajectories)

        def write_summary(path: Path) -> None:
            summary = json.dumps({**self.summary(), "end": end}, indent=2, allow_nan=False)
            replace_file(path, f"{summary}\n".encode(), "the summary")

        return {
            **{name: _trajectory_writer(make) for name, make in trajectories.items()},
            "map.ply": lambda path: write_ply(path, self.map.cloud(self.visual.trajectories.estimates)),
            "timing.csv": self.timing.write_csv,
            "summary.json": write_summary,
        }

    def _track(self, frame: Frame) -> None:
        prediction = self._prediction(frame.stamp_ns)
        tracked = self.visual.track(frame.image, frame.stamp_ns, frame.exposure_ms, prediction, frame.right)
        self.map.add(tracked.status)
        if self._watch is not None:
            self._watch(tracked.image, tracked.status)
        if self._recorder is not None:
            for view in self._recorder.add(tracked.image, tracked.status):
                self._maker.add_view(view)
        self.timing.add(tracked.status, tracked.total_ms)
        if tracked.status.T_world_camera is None:
            self._untracked.add(tracked.status.message)
        if tracked.status.state is TrackingState.LOST:
            when, why = format_stamp(frame.stamp_ns), tracked.status.message
            self.warnings.add(f"the map was lost at {when}: {why}", f"the map was lost: {why}")
        if self._fusion is not None:
            self._fusion.add(tracked.status)
            self._make_records(self._fusion)

    def _make_records(self, fusion: FusionPlayback) -> None:
        if self._recorder is not None:
            for pose in fusion.estimator.take_left():
                self._maker.add_pose(pose)
            self.records += self._maker.take(fusion.estimator.robot.T_base_camera)

    def _prediction(self, stamp_ns: int) -> Optional[CameraMotion]:
        if not self._predict or self._fusion is None or self.visual.last is None:
            return None
        return self._fusion.predicted_motion(self.visual.last, stamp_ns)


def _trajectory_writer(make: Callable[[], Trajectory]) -> Callable[[Path], None]:
    return lambda path: write_tum(path, make())
