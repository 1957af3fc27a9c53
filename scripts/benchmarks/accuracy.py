# SPDX-License-Identifier: BSD-3-Clause
"""The odometry's accuracy and robustness against their limits, on the shared recordings and on simulated drives.

Simulated images are 848x480 at 30 Hz. The drives are rendered once, into bags in the folder, 5 GB a seed; the
odometry's results are kept there, too, and each part's figures are written to PART.json. So parts can be run one by
one, and an interrupted part continues where it stopped.
"""

import argparse
import json
import shutil
import sys
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Callable, Dict, Iterator, List

import numpy as np
from support.ablation import ablation
from support.checkout import DATA
from support.endurance import long
from support.first_maps import first_maps
from support.lenses import lenses
from support.random_roofs import low_rates, roofs
from support.regulation import regulation
from support.shared_starts import first_poses, hard, reference_drives
from support.stereo import FIRST_ROOF, stereo
from support.table import Row, report
from support.uncovered import uncovered

from ceiling_dso_ros.evaluation.alignment import AlignmentKind
from ceiling_dso_ros.evaluation.report import evaluate_trajectory
from ceiling_dso_ros.experiments.kept_runs import Kept, OdometryRun, is_missing
from ceiling_dso_ros.experiments.rendered_drives import RenderedDrives
from ceiling_dso_ros.experiments.tracked_drives import TrackedDrives
from ceiling_dso_ros.experiments.tracked_run import TrackedRun
from ceiling_dso_ros.io.trajectory import read_tum
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.events import COVER_SLIDE_S
from ceiling_dso_ros.simulation.sensors.measurements import stamp_ns

# Of the C++ reference: final and live error in metres with nearest stamps, index of the first image with a pose.
REFERENCES = {"ceiling_loops": (0.0020, 0.0022, 46), "tum_fr1_xyz": (0.0193, 0.0214, 6)}
PAIRING_S = 0.02
STARTS, WORST_START_MM = (0, 1, 2, 3, 4, 5, 6, 7, 9, 12), 30.0
MEDIAN_PERCENT, WORST_PERCENT = 0.02, 0.05  # of the path
SEQUENCES, TEXTURED, FAINT = ("square", "loops"), ("factory", "tiles", "warehouse"), "plaster"
WRONG_S = 1.0  # longest time for which a wrong pose may be reported as good
FULL_HZ = 30
EVENT_S, EVENT_DRIVE_S, COVER_S = 15.0, 30.0, 3.0  # start of an event, length of the drive
RECOVERY_S = 2.0  # of motion
NEES_FACTOR = 3.0


def recordings(tracked: TrackedDrives, _: int) -> Iterator[Row]:
    """The two shared recordings against the C++ reference."""
    for name, (final_m, live_m, first) in REFERENCES.items():
        if is_missing(DATA / name):
            continue
        nearest, exact = tracked.shared(name, exact=False), tracked.shared(name)
        theirs = evaluate_trajectory(
            "", read_tum(DATA / name / "reference_final.tum"), read_tum(DATA / name / "groundtruth.tum"),
            AlignmentKind.SIM3, PAIRING_S, interpolate=True,
        )  # fmt: skip
        yield Row(name, "final ATE, nearest stamps, mm", [1e3 * nearest.final_ate_m], 1e3 * final_m)
        yield Row(name, "live ATE, nearest stamps, mm", [1e3 * nearest.live_ate_m], 1e3 * live_m)
        yield Row(name, "final ATE, truth at the stamps, mm", [1e3 * exact.final_ate_m], 1e3 * theirs.ate_m.rmse)
        yield Row(name, "live ATE, truth at the stamps, mm", [1e3 * exact.live_ate_m])
        yield Row(name, "first image with a pose", [exact.first_pose], first)
        yield Row(name, "times lost", [exact.lost], 0)


def starts(tracked: TrackedDrives, _: int) -> Iterator[Row]:
    """Track the hand-held recording from several first images on: shows how much of its error is chance."""
    name = "tum_fr1_xyz"
    if is_missing(DATA / name):
        return
    runs = [tracked.shared(name, OdometryRun(first=first), f" from {first}") for first in STARTS]
    subject = f"{name}, from images {', '.join(map(str, STARTS))}"
    yield Row(subject, "final ATE, truth at the stamps, mm", [1e3 * run.final_ate_m for run in runs], WORST_START_MM)


def seeds(tracked: TrackedDrives, count: int) -> Iterator[Row]:
    """Square and loops under every ceiling."""
    for ceiling in (*TEXTURED, FAINT):
        for sequence in SEQUENCES:
            runs = [tracked.drive(SimulationConfig(sequence, ceiling, seed)) for seed in range(count)]
            yield from (_faint if ceiling == FAINT else _textured)(f"{sequence}, {ceiling}", runs)


def _textured(subject: str, runs: List[TrackedRun]) -> Iterator[Row]:
    percent = [run.final_ate_percent for run in runs]
    yield Row(subject, "final ATE, % of path", percent, WORST_PERCENT)
    yield Row(subject, "its median", [float(np.median(percent))], MEDIAN_PERCENT)
    yield Row(subject, "times lost", [run.lost for run in runs], 0)
    yield Row(subject, "motion before the first pose, s", [run.motion_before_first_pose_s() for run in runs])


def _faint(subject: str, runs: List[TrackedRun]) -> Iterator[Row]:
    unsaid = [sum(loss.endswith(": ") for loss in run.losses()) for run in runs]
    yield Row(subject, "losses without a reason", unsaid, 0)
    yield Row(subject, "longest time beyond 5 sigma, s", [run.longest_wrong_s() for run in runs], WRONG_S)
    yield Row(subject, "times lost", [run.lost for run in runs])
    yield Row(subject, "images tracked from the first pose on, %", [run.tracked_percent for run in runs])
    yield Row(subject, "final ATE of all segments, % of path", [run.final_ate_percent for run in runs])


def rates(tracked: TrackedDrives, count: int) -> Iterator[Row]:
    """Loops under the factory roof with images left out."""
    drives = [SimulationConfig("loops", "factory", seed) for seed in range(count)]
    full = [tracked.drive(drive).final_ate_m for drive in drives]
    for hz, predict, limit in (
        (15, False, 2.0),
        (6, False, 2.0),
        (6, True, np.inf),
        (3, True, 3.0),
        (3, False, np.inf),
    ):
        run = OdometryRun(every=FULL_HZ // hz, predict=predict)
        variant = f" {hz} Hz{' with wheels' if predict else ''}"
        runs = [tracked.drive(drive, run, variant) for drive in drives]
        subject = f"loops, factory,{variant}"
        yield Row(subject, "final ATE / that of 30 Hz", np.divide([r.final_ate_m for r in runs], full), limit)
        yield Row(subject, "times lost", [r.lost for r in runs], 0 if np.isfinite(limit) else np.inf)
        yield Row(subject, "images tracked from the first pose on, %", [r.tracked_percent for r in runs])


def events(tracked: TrackedDrives, count: int) -> Iterator[Row]:
    """Events on a part of `loops`, and the two sequences `spin` and `stop_and_go`."""
    for event, length_s in (("lights_off", 0.3), ("cover", COVER_S), ("flicker", 5.0)):
        what = f"{event}@{EVENT_S:g}+{length_s:g}"
        configs = [SimulationConfig("loops", seed=s, duration_s=EVENT_DRIVE_S, events=(what,)) for s in range(count)]
        runs = [tracked.drive(config) for config in configs]
        event_ns = (stamp_ns(EVENT_S), stamp_ns(EVENT_S + length_s))
        yield from _recovered(f"loops, {event}", runs, [run.motion_without_pose_s(*event_ns) for run in runs])
        if event == "cover":
            first_ns = stamp_ns(EVENT_S + COVER_SLIDE_S)
            covered = [run.tracking_within(first_ns, event_ns[1]) for run in runs]
            yield Row(f"loops, {event}", "covered images with a pose", covered, 0)
    for sequence in ("spin", "stop_and_go"):
        runs = [tracked.drive(SimulationConfig(sequence, seed=seed)) for seed in range(count)]
        yield from _recovered(sequence, runs, [run.motion_without_pose_s() for run in runs])


def _recovered(subject: str, runs: List[TrackedRun], without_s: List[float]) -> Iterator[Row]:
    yield Row(subject, "longest motion without a pose, s", without_s, RECOVERY_S)
    yield Row(subject, "motion before the first pose, s", [run.motion_before_first_pose_s() for run in runs])
    yield Row(subject, "times lost", [run.lost for run in runs])
    yield Row(subject, "final ATE of all segments, mm", [1e3 * run.final_ate_m for run in runs])
    yield Row(subject, "its share of the path, %", [run.final_ate_percent for run in runs], WORST_PERCENT)


def covariance(tracked: TrackedDrives, count: int) -> Iterator[Row]:
    """Whether the errors of poses relative to their keyframes agree with their covariances."""
    for ceiling in TEXTURED:
        for sequence in SEQUENCES:
            runs = [tracked.drive(SimulationConfig(sequence, ceiling, seed)) for seed in range(count)]
            nees = [run.mean_nees / 6.0 for run in runs]
            yield Row(f"{sequence}, {ceiling}", "mean NEES / 6", nees, NEES_FACTOR, 1.0 / NEES_FACTOR)


PARTS: Dict[str, Callable[[TrackedDrives, int], Iterator[Row]]] = {
    part.__name__: part
    for part in (
        *(recordings, starts, first_poses, hard, reference_drives, roofs, low_rates, first_maps, lenses),
        *(seeds, rates, regulation, events, uncovered, covariance, long, ablation, stereo),
    )
}


def main() -> int:
    """Print one table; 1 when a limit does not hold."""
    parser = argparse.ArgumentParser(prog="scripts/bench accuracy", description=__doc__)
    parser.add_argument(
        "--out", metavar="DIR", type=Path, default=Path("out/bench/accuracy"), help="default %(default)s"
    )
    parser.add_argument("--seeds", metavar="N", type=int, default=5, help="drives, halls; default %(default)s")
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS), metavar="PART", help=", ".join(PARTS))
    parser.add_argument(
        "--first-roof", metavar="SEED", type=int, default=FIRST_ROOF,
        help="first of the random roofs of `stereo`; default %(default)s, those for judging",
    )  # fmt: skip
    parser.add_argument("--fresh", action="store_true", help="track what has been tracked before, too")
    options = parser.parse_args()
    PARTS["stereo"] = partial(stereo, first=options.first_roof)
    if options.fresh:
        shutil.rmtree(options.out / "tracked", ignore_errors=True)
    tracked = TrackedDrives(RenderedDrives(options.out / "drives"), Kept(options.out / "tracked"), DATA)
    options.out.mkdir(parents=True, exist_ok=True)
    rows: List[Row] = []
    for name in options.only:
        of_part = list(PARTS[name](tracked, options.seeds))
        (options.out / f"{name}.json").write_text(json.dumps([_figures(row) for row in of_part], indent=1) + "\n")
        rows += of_part
    print(report(rows))
    return 0 if all(row.holds for row in rows) else 1


def _figures(row: Row) -> Dict[str, object]:
    """A row for JSON: no limit is null."""
    limits = {name: limit if np.isfinite(limit) else None for name, limit in (("low", row.low), ("high", row.high))}
    return {**asdict(row), "values": [float(value) for value in row.values], **limits, "holds": row.holds}


if __name__ == "__main__":
    sys.exit(main())
