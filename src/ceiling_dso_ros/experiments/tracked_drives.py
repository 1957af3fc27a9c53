# SPDX-License-Identifier: BSD-3-Clause
"""Recordings and simulated drives with the odometry's results, both kept in a folder."""

from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

from ceiling_dso_ros.experiments.kept_runs import Kept, OdometryRun
from ceiling_dso_ros.experiments.rendered_drives import RenderedDrives
from ceiling_dso_ros.experiments.tracked_run import TrackedRun
from ceiling_dso_ros.io.opening import open_recording
from ceiling_dso_ros.io.trajectory import read_tum
from ceiling_dso_ros.simulation.config import SimulationConfig


@dataclass(frozen=True)
class TrackedDrives:
    """Renders and tracks what does not exist yet, and prints one line for each run.

    Attributes:
        rendered: bags of the simulated drives.
        kept: the odometry's results.
        recordings: folder of the shared recordings.
    """

    rendered: RenderedDrives
    kept: Kept
    recordings: Path

    def drive(self, config: SimulationConfig, run: OdometryRun = OdometryRun(), variant: str = "") -> TrackedRun:
        """A simulated drive; `variant` names a run that differs from the default."""
        drive = self.rendered.drive(config)
        name = drive.name + variant
        tracked = TrackedRun(self.kept.statuses(drive.recording, name, run), drive.simulated.camera_truth)
        return _told(name, tracked)

    def shared(self, name: str, run: OdometryRun = OdometryRun(), variant: str = "", exact: bool = True) -> TrackedRun:
        """A shared recording; exact: interpolate the truth at the stamps, instead of taking its nearest poses."""
        statuses = self.kept.statuses(open_recording(self.recordings / name), name + variant, run)
        return _told(name + variant, TrackedRun(statuses, read_tum(self.recordings / name / "groundtruth.tum"), exact))


def _told(name: str, run: TrackedRun) -> TrackedRun:
    tqdm.write(f"{name}: {run}")
    for loss in run.losses():
        tqdm.write(f"    lost at {loss}")
    return run
