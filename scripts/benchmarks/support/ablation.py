# SPDX-License-Identifier: BSD-3-Clause
"""What each part of the odometry contributes: the error with it switched off or changed.

As a script it tracks with one of `CHANGES`: `python -m support.ablation CHANGE DRIVES KEPT SEEDS [RECORDING...]`.
"""

import os
import subprocess
import sys
from pathlib import Path
from typing import Dict, Iterator, List, Sequence, Tuple

from support.checkout import DATA
from support.method_changes import CHANGES
from support.table import Row

from ceiling_dso_ros.experiments.kept_runs import Kept, OdometryRun, is_missing
from ceiling_dso_ros.experiments.rendered_drives import RenderedDrives
from ceiling_dso_ros.experiments.tracked_drives import TrackedDrives
from ceiling_dso_ros.experiments.tracked_run import TrackedRun
from ceiling_dso_ros.settings import load_settings
from ceiling_dso_ros.simulation.config import SimulationConfig

FIXED = 1e12  # information so large that the images add nothing
AFFINE = ("affine_a_information", "affine_b_information")

# As `run --set` takes them.
VARIANTS: Dict[str, Tuple[str, ...]] = {
    "as it is": (),
    "no prior from marginalisation": ("optimization.marginalization_weight=1e-9",),
    "its full weight, 1": ("optimization.marginalization_weight=1",),
    "affine parameters fixed": tuple(
        f"{part}.{name}={FIXED}" for part in ("tracking", "optimization") for name in AFFINE
    ),
    "intrinsics fixed": (f"optimization.intrinsics_information={FIXED}",),
    "intrinsics free": ("optimization.intrinsics_information=0",),
    "500 points, 750 candidates": ("window.active_points=500", "window.candidate_points=750"),
    "2000 points, 3000 candidates": ("window.active_points=2000", "window.candidate_points=3000"),
    "5 keyframes": ("window.max_keyframes=5",),
    "15 keyframes": ("window.max_keyframes=15",),
    "7 keyframes, 2000 points, as published": ("window.max_keyframes=7", "window.active_points=2000"),
    "2 iterations": ("optimization.iterations=2",),
    "keyframes half as far apart": ("keyframe.translation_weight=72", "keyframe.motion_weight=36"),
    "keyframes twice as far apart": ("keyframe.translation_weight=18", "keyframe.motion_weight=9"),
    "candidates search all depths": ("tracing.depth_margin=1000",),
    "matches half as distinct, 2": ("activation.min_quality=2",),
    "initialiser: depths free from the start": ("initialization.flat_coupling=1",),
    "initialiser: ends at once after the snap": ("initialization.frames_after_snap=0",),
    "initialiser: takes any first map": ("initialization.min_texture=0", "initialization.min_point_texture=0"),
}
RECORDINGS = ("ceiling_loops", "tum_fr1_xyz")
DRIVE = ("square", "factory")


def ablation(tracked: TrackedDrives, seeds: int) -> Iterator[Row]:
    """Two recordings and a simulated drive, with one thing changed at a time."""
    recordings = [name for name in RECORDINGS if not is_missing(DATA / name)]
    for title, settings in VARIANTS.items():
        variant = "".join(f" {setting}" for setting in settings)
        run = OdometryRun(load_settings(None, settings))
        yield from _rows(title, _runs(tracked, recordings, seeds, run, variant))
    for change in CHANGES:
        _track_changed(change, tracked, recordings, seeds)
        yield from _rows(change, _runs(tracked, recordings, seeds, OdometryRun(), f" {change}"))


def _runs(
    tracked: TrackedDrives, recordings: Sequence[str], seeds: int, run: OdometryRun, variant: str
) -> Dict[str, List[TrackedRun]]:
    """The runs by the name of the tracked recording or drive."""
    runs = {name: [tracked.shared(name, run, variant)] for name in recordings}
    drives = [tracked.drive(SimulationConfig(*DRIVE, seed), run, variant) for seed in range(seeds)]
    return {**runs, ", ".join(DRIVE): drives}


def _rows(title: str, runs: Dict[str, List[TrackedRun]]) -> Iterator[Row]:
    for name, results in runs.items():
        yield Row(title, f"final ATE on {name}, mm", [1e3 * result.final_ate_m for result in results])
        yield Row(title, f"times lost on {name}", [result.lost for result in results])


def _track_changed(change: str, tracked: TrackedDrives, recordings: Sequence[str], seeds: int) -> None:
    """Track with the changed method in another process, where there is no result yet."""
    kernels = tracked.kept.folder / "kernels" / change.replace(" ", "_")
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(kernels.resolve()), "CEILING_DSO_DATA": str(DATA.resolve())}
    folders = [str(folder.resolve()) for folder in (tracked.rendered.folder, tracked.kept.folder)]
    command = [sys.executable, "-m", "support.ablation", change, *folders, str(seeds), *recordings]
    subprocess.run(command, cwd=Path(__file__).resolve().parents[1], env=environment, check=True)


def main() -> None:
    """Change the method and track."""
    change, drives, kept, seeds, *recordings = sys.argv[1:]
    CHANGES[change]()
    tracked = TrackedDrives(RenderedDrives(Path(drives)), Kept(Path(kept)), DATA)
    _runs(tracked, recordings, int(seeds), OdometryRun(), f" {change}")


if __name__ == "__main__":
    main()
