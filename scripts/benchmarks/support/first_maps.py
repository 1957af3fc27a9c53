# SPDX-License-Identifier: BSD-3-Clause
"""Many starts of the odometry in halls drawn at random: while standing, on every kind of way, and under a cover.

A wrong first map stays wrong for its whole segment. Half of the starts have no wheels.
"""

from dataclasses import replace
from functools import partial
from typing import Callable, Dict, Iterator, List, NamedTuple

import numpy as np
from support.random_roofs import JUDGING
from support.table import Row
from support.uncovered import WORST_PERCENT, covered

from ceiling_dso_ros.evaluation.association import interpolate_poses
from ceiling_dso_ros.experiments.kept_runs import OdometryRun
from ceiling_dso_ros.experiments.rendered_drives import RenderedDrive
from ceiling_dso_ros.experiments.tracked_drives import TrackedDrives
from ceiling_dso_ros.experiments.tracked_run import TrackedRun
from ceiling_dso_ros.io.recording import ListedImage, Recording
from ceiling_dso_ros.io.recording_view import RecordingPart, RecordingView
from ceiling_dso_ros.simulation.drawn import draw_config

HALLS, STARTS = 25, 4  # of each kind in each hall
FOLLOWED_S = 5.0  # from a start on
DRIVE_S = 40.0
GRID_S, HALF_S = 0.1, 0.15  # times that are looked at; over twice this time motion is measured, for the base vibrates


class Way(NamedTuple):
    """Speed and yaw rate of the base at (n,) times, m/s and rad/s."""

    speed_m_s: np.ndarray
    turn_rad_s: np.ndarray


# Name -> the drive, and at which times of it a start is of that kind.
KINDS: Dict[str, Callable[[Way], np.ndarray]] = {
    "standing": lambda way: (way.speed_m_s < 0.01) & (way.turn_rad_s < 0.01),
    "straight": lambda way: (way.speed_m_s > 0.3) & (way.turn_rad_s < 0.1),
    "tight turn": lambda way: (way.speed_m_s > 0.2) & (way.turn_rad_s > 0.5),
    "on the spot": lambda way: (way.speed_m_s < 0.05) & (way.turn_rad_s > 0.3),
    "cover": lambda way: way.speed_m_s > 0.3,
}
SEQUENCES = {
    "standing": "stop_and_go",
    "straight": "stop_and_go",
    "tight turn": "loops",
    "on the spot": "spin",
    "cover": "loops",
}


class Start(NamedTuple):
    """One start: its kind, with wheels or not, and how it was tracked."""

    kind: str
    wheels: bool
    run: TrackedRun


class Uncovered(RecordingView):
    """A recording during whose first images a cover slides off the lens.

    Args:
        recording: that is seen.
        phase: progress of the cover in the first image, as a share of its motion per image.
    """

    def __init__(self, recording: Recording, phase: float) -> None:
        super().__init__(recording)
        self._phase = phase

    def images(self) -> Iterator[ListedImage]:
        """See Recording."""
        for number, listed in enumerate(super().images()):
            yield replace(listed, decode=partial(_uncovered, listed.decode, number + self._phase))


def _uncovered(decode: Callable[[], np.ndarray], images: float) -> np.ndarray:
    return covered(decode(), images).astype(np.uint8)


def first_maps(tracked: TrackedDrives, count: int) -> Iterator[Row]:
    """Starts of every kind in each hall."""
    halls = min(count, HALLS)
    starts = [start for seed in range(JUDGING, JUDGING + halls) for start in _starts(tracked, seed)]
    for kind in KINDS:
        for wheels in (True, False):
            of_kind = [start.run for start in starts if (start.kind, start.wheels) == (kind, wheels)]
            subject = f"{kind}, {len(of_kind)} starts{'' if wheels else ' without wheels'}"
            posed = [run for run in of_kind if np.isfinite(run.final_ate_m)]
            wrong = [run for run in posed if run.final_ate_percent > WORST_PERCENT]
            yield Row(subject, "without a pose, lost", [len(of_kind) - len(posed), sum(run.lost for run in of_kind)])
            yield Row(subject, f"wrong by more than {WORST_PERCENT} % of the way", [len(wrong)], 0)
            if posed:
                percent = [run.final_ate_percent for run in posed]
                yield Row(subject, "final ATE, % of path: median, 95 %, worst", np.percentile(percent, (50, 95, 100)))
                first_s = [run.motion_before_first_pose_s() for run in posed]
                yield Row(subject, "motion before the first pose, s: median, 95 %", np.percentile(first_s, (50, 95)))
    yield Row("all", "starts", [len(starts)])


def _starts(tracked: TrackedDrives, seed: int) -> Iterator[Start]:
    phases = np.random.default_rng(seed)
    for kind, is_of_kind in KINDS.items():
        drive = tracked.rendered.drive(draw_config(SEQUENCES[kind], seed, duration_s=DRIVE_S))
        for number, start_s in enumerate(_times_s(drive, is_of_kind)):
            wheels = (number + seed) % 2 == 0
            part: Recording = RecordingPart(drive.recording, start_s, FOLLOWED_S)
            if kind == "cover":
                part = Uncovered(part, phases.uniform())
            name = f"{drive.name} {kind} from {start_s:.1f} s{'' if wheels else ' without wheels'}"
            statuses = tracked.kept.statuses(part, name, OdometryRun(predict=wheels))
            yield Start(kind, wheels, TrackedRun(statuses, drive.simulated.camera_truth))


def _times_s(drive: RenderedDrive, is_of_kind: Callable[[Way], np.ndarray]) -> List[float]:
    """Up to STARTS times since the first image, spread over those of a kind."""
    truth = drive.simulated.base_truth
    first_s, last_s = 1e-9 * truth.stamps_ns[0] + HALF_S, 1e-9 * truth.stamps_ns[-1] - FOLLOWED_S
    times_s = np.arange(first_s, last_s, GRID_S)
    before, after = (
        interpolate_poses(truth.stamps_ns, truth.matrices(), np.round(1e9 * (times_s + side)).astype(np.int64))
        for side in (-HALF_S, HALF_S)
    )
    speed_m_s = np.linalg.norm(after[:, :2, 3] - before[:, :2, 3], axis=1) / (2.0 * HALF_S)
    turned = np.arcsin(np.clip(before[:, 0, 0] * after[:, 1, 0] - before[:, 1, 0] * after[:, 0, 0], -1.0, 1.0))
    chosen = times_s[is_of_kind(Way(speed_m_s, np.abs(turned) / (2.0 * HALF_S)))]
    first_image_s = 1e-9 * drive.simulated.camera_truth.stamps_ns[0]
    spread = chosen[np.linspace(0, len(chosen) - 1, min(STARTS, len(chosen))).astype(int)] if len(chosen) else chosen
    return [max(0.0, float(time_s - first_image_s)) for time_s in spread]
