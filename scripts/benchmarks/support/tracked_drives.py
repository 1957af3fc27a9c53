"""Recordings and simulated drives after the odometry, both kept in a folder."""

import os
from dataclasses import dataclass
from pathlib import Path

from support.drives import Kept, OdometryRun
from support.rendered import RenderedDrives
from support.tracked_run import TrackedRun
from tqdm import tqdm

from ceiling_dso_ros.io.opening import open_recording
from ceiling_dso_ros.io.trajectory import read_tum
from ceiling_dso_ros.simulation.config import SimulationConfig

CHECKOUT = Path(__file__).resolve().parents[3]
DATA = Path(os.environ.get("CEILING_DSO_DATA", CHECKOUT.parent / "shared" / "data"))


@dataclass(frozen=True)
class TrackedDrives:
    """Renders and tracks what is not there yet, and tells of each run in a line.

    Attributes:
        rendered: bags of the simulated drives.
        kept: what the odometry said of them.
    """

    rendered: RenderedDrives
    kept: Kept

    def drive(self, config: SimulationConfig, run: OdometryRun = OdometryRun(), variant: str = "") -> TrackedRun:
        """A simulated drive; `variant` names another run than the usual one."""
        drive = self.rendered.drive(config)
        name = drive.name + variant
        tracked = TrackedRun(self.kept.statuses(drive.recording, name, run), drive.simulated.camera_truth)
        return _told(name, tracked)

    def shared(self, name: str, run: OdometryRun = OdometryRun(), variant: str = "", exact: bool = True) -> TrackedRun:
        """A shared recording; exact: against the truth interpolated at the stamps instead of that of nearest stamps."""
        statuses = self.kept.statuses(open_recording(DATA / name), name + variant, run)
        return _told(name + variant, TrackedRun(statuses, read_tum(DATA / name / "groundtruth.tum"), exact))


def _told(name: str, run: TrackedRun) -> TrackedRun:
    tqdm.write(f"{name}: {run}")
    for loss in run.losses():
        tqdm.write(f"    lost at {loss}")
    return run
