# SPDX-License-Identifier: BSD-3-Clause
"""Results of the odometry for recordings, kept in a folder because rendering and tracking a drive takes minutes."""

import io
import itertools
import pickle
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, List, Tuple

from tqdm import tqdm

from ceiling_dso_ros import dso, simulation
from ceiling_dso_ros.dso import OdometryConfig, OdometryStatus, TrackingState, hosted_points, status
from ceiling_dso_ros.dso.durations import nanoseconds
from ceiling_dso_ros.experiments.source_digest import source_digest
from ceiling_dso_ros.io.recording import Frame, Recording
from ceiling_dso_ros.playback.fusion_playback import FusionPlayback
from ceiling_dso_ros.playback.visual_run import VisualRun
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.recording import SimulatedRecording

UNSEEN_EVENTS = ("slip",)
# What pickles of arrays and of their numbers name.
OF_ARRAYS = (
    ("numpy", "ndarray"),
    ("numpy", "dtype"),
    ("numpy.core.multiarray", "_reconstruct"),
    ("numpy.core.multiarray", "scalar"),
)

Statuses = Tuple[OdometryStatus, ...]


@dataclass(frozen=True)
class OdometryRun:
    """How a recording is tracked.

    Attributes:
        config: the odometry's settings.
        first: index of the first image that is tracked.
        every: one of this many images is tracked.
        predict: predict the motion of the camera from the wheels.
        regulated: leave images out while hardly anything moves, see `FrameRegulation`.
        exposures_told: use the exposure times of the recording.
    """

    config: OdometryConfig = OdometryConfig()
    first: int = 0
    every: int = 1
    predict: bool = False
    regulated: bool = False
    exposures_told: bool = True

    def track(self, recording: Recording, name: str) -> Statuses:
        """Track the images; the status of each."""
        visual = VisualRun.of(recording, self.config)
        visual.regulate(self.regulated)
        fusion = FusionPlayback.of(recording) if self.predict else None
        frames = tqdm(recording.frames(), desc=name, total=len(recording), unit="frame", disable=None)
        statuses: List[OdometryStatus] = []
        usable = (frame for frame in frames if isinstance(frame, Frame))
        for frame in itertools.islice(usable, self.first, None, self.every):
            prediction = fusion.predicted_motion(statuses[-1], frame.stamp_ns) if fusion and statuses else None
            if visual.leaves_out(frame.stamp_ns, prediction):
                continue
            exposure_ms = frame.exposure_ms if self.exposures_told else None
            tracked = visual.track(frame.image, frame.stamp_ns, exposure_ms, prediction, frame.right)
            statuses.append(tracked.status)
            if fusion is not None:
                fusion.add(statuses[-1])
        return tuple(statuses)


@dataclass(frozen=True)
class Kept:
    """Folder in which the odometry's results for recordings are kept.

    Attributes:
        folder: made if missing.
        fresh: track again even if a result exists.
    """

    folder: Path
    fresh: bool = False

    def statuses(self, recording: Recording, name: str, run: OdometryRun = OdometryRun()) -> Statuses:
        """Status of every image of a recording, from the folder if there is a result of that name, else tracked now."""
        path, version = self.folder / f"{name}.pickle", source_digest(dso, simulation)
        if self.fresh or not path.exists():
            self.folder.mkdir(parents=True, exist_ok=True)
            path.write_bytes(pickle.dumps((version, run.track(recording, name))))
        statuses: Statuses
        tracked_by, statuses = _Unpickler(io.BytesIO(path.read_bytes())).load()
        if tracked_by != version:
            print(f"{path}: made by another version of odometry or simulator; --fresh tracks again", file=sys.stderr)
        return statuses

    def drive(self, config: SimulationConfig) -> Tuple[SimulatedRecording, Statuses]:
        """Statuses of a simulated drive with the default length, camera and vibration.

        Wheels, slip and late stamps do not change them.
        """
        seen = tuple(event for event in config.events if event.partition("@")[0] not in UNSEEN_EVENTS)
        name = "_".join([config.sequence, config.ceiling, str(config.seed), *seen])
        statuses = self.statuses(SimulatedRecording(replace(config, events=seen, time_offset_s=0.0)), name)
        offset_ns = nanoseconds(config.time_offset_s)
        late = (replace(status, stamp_ns=status.stamp_ns + offset_ns) for status in statuses)
        return SimulatedRecording(config), tuple(late) if offset_ns else statuses


def is_missing(folder: Path) -> bool:
    """Whether a shared recording is missing; prints a message if it is."""
    if not folder.is_dir():
        print(f"{folder} is missing, skipped: set CEILING_DSO_DATA to the folder of the recordings", file=sys.stderr)
    return not folder.is_dir()


class _Unpickler(pickle.Unpickler):
    """Reads results and nothing else: any other pickle could run what it likes."""

    def find_class(self, module: str, name: str) -> Any:  # noqa: ANN401
        """A class or function that a pickle names."""
        if (module, name) == ("builtins", "getattr"):  # how Python 3.11 names members of enumerations
            return _state
        if module in (status.__name__, hosted_points.__name__) or (module, name) in OF_ARRAYS:
            return super().find_class(module, name)
        raise pickle.UnpicklingError(f"{module}.{name} is no part of a result; --fresh tracks again")


def _state(kind: type, name: str) -> TrackingState:
    if kind is not TrackingState:
        raise pickle.UnpicklingError(f"{kind}.{name} is no part of a result; --fresh tracks again")
    return TrackingState[name]
