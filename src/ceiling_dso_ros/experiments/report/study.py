# SPDX-License-Identifier: BSD-3-Clause
"""The runs of a study as a sweep has left them."""

import csv
import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple

from ceiling_dso_ros.evaluation.alignment import AlignmentKind
from ceiling_dso_ros.evaluation.report import EvaluationError, TrajectoryEvaluation, evaluate_trajectory
from ceiling_dso_ros.experiments.sweep.answering import DONE
from ceiling_dso_ros.experiments.sweep.one_run import PAIRING_S
from ceiling_dso_ros.experiments.sweep.plan import Plan, read_plan
from ceiling_dso_ros.experiments.sweep.store import PLAN, REFERENCES, ROW, RUNS, TABLE
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.trajectory import Trajectory, read_tum

WINDOW = "window.max_keyframes"
OF_THE_PAPER = ("size", "fps", WINDOW)


@dataclass(frozen=True)
class Combination:
    """What is compared: the paper's three dimensions, and all others of the study as one text.

    Attributes:
        size: of the images, WxH.
        rate_hz: images a second.
        window: largest number of keyframes.
        variant: the other dimensions, `key=value` with spaces between them; empty without any.
    """

    size: str
    rate_hz: float
    window: int
    variant: str

    def __str__(self) -> str:
        """In one line."""
        text = f"{self.size}, {self.rate_hz:g} Hz, {self.window} keyframes"
        return f"{text}, {self.variant}" if self.variant else text


@dataclass(frozen=True)
class StudyRun:
    """A run that has ended.

    Attributes:
        name: of its folder.
        folder: with its files.
        combination: what was varied.
        sequence, drive, seed: of the recording.
        row: its row of runs.csv, with numbers; None for what is not known.
        references: folder of the references.
    """

    name: str
    folder: Path
    combination: Combination
    sequence: str
    drive: str
    seed: int
    row: Mapping[str, Any]
    references: Path

    @property
    def is_done(self) -> bool:
        """Whether it has numbers."""
        return bool(self.row["status"] == DONE)

    def number(self, name: str) -> Optional[float]:
        """A number of the row, None if it is not known."""
        value = self.row.get(name)
        return None if value is None else float(value)

    @property
    def pair(self) -> Tuple[str, str, int]:
        """What runs of two combinations have in common that can be compared one by one."""
        return self.sequence, self.drive, self.seed

    @cached_property
    def reference(self) -> Optional[Trajectory]:
        """True poses of the camera, None without any."""
        name = self.row.get("reference")
        return None if name is None else read_tum(self.references / name)

    @cached_property
    def evaluation(self) -> Optional[TrajectoryEvaluation]:
        """The final trajectory against the reference; None where they cannot be compared."""
        path = self.folder / "camera_final.tum"
        if self.reference is None or not path.exists():
            return None
        try:
            estimate = read_tum(path)
            return evaluate_trajectory("", estimate, self.reference, AlignmentKind.SIM3, PAIRING_S, interpolate=True)
        except (EvaluationError, InputError):
            return None


@dataclass(frozen=True)
class Study:
    """A study.

    Attributes:
        folder: of the study.
        plan: of the study.
        runs: in the order of the plan.
        baseline: what the other combinations are compared with.
    """

    folder: Path
    plan: Plan
    runs: Sequence[StudyRun]
    baseline: Combination

    @property
    def sequences(self) -> List[str]:
        """Their names, in the order of the plan."""
        return [*dict.fromkeys(run.sequence for run in self.runs)]

    @property
    def combinations(self) -> List[Combination]:
        """In the order of the plan."""
        return [*dict.fromkeys(run.combination for run in self.runs)]

    def values(self, dimension: str) -> List[Any]:
        """The values of an attribute of the combinations: rates and windows increase, others are as in the plan."""
        found = [*dict.fromkeys(getattr(each, dimension) for each in self.combinations)]
        return sorted(found) if dimension in ("rate_hz", "window") else found

    def of(self, combination: Combination, sequence: Optional[str] = None) -> List[StudyRun]:
        """Runs that are done, of one sequence or of all."""
        return [
            run
            for run in self.runs
            if run.is_done and run.combination == combination and sequence in (None, run.sequence)
        ]

    def numbers(self, name: str, combination: Combination, sequence: Optional[str] = None) -> List[float]:
        """The known numbers of these runs."""
        found = [run.number(name) for run in self.of(combination, sequence)]
        return [value for value in found if value is not None]


def read_study(folder: Path) -> Study:
    """Read what a sweep has written.

    Raises:
        InputError: there is no study, or a file of it is damaged.
    """
    table = folder / TABLE
    if not table.is_file():
        raise InputError(f"{table}: there is no such file; give the folder of `sweep --out`")
    plan = read_plan(folder / PLAN)
    with table.open(newline="") as file:
        rows = [*csv.DictReader(file)]
    try:
        runs = [_run(folder, row, plan) for row in rows]
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"{folder}: a run is damaged: {type(error).__name__}: {error}") from error
    if not runs:
        raise InputError(f"{table}: there are no runs")
    return Study(folder, plan, runs, _baseline(plan, runs))


def _run(folder: Path, listed: Mapping[str, str], plan: Plan) -> StudyRun:
    content = json.loads((folder / RUNS / listed["run"] / ROW).read_text())
    spec, row = content["spec"], content["row"]
    varied = {name: listed[name] for name in plan.grid}
    size = varied.get("size") or spec["conditions"]["size"] or row.get("image") or "own size"
    rate_hz = float(varied.get("fps") or spec["conditions"]["fps"] or round(row.get("rate_hz") or 0.0, 1))
    variant = " ".join(f"{name}={value}" for name, value in varied.items() if name not in OF_THE_PAPER)
    return StudyRun(
        listed["run"],
        folder / RUNS / listed["run"],
        Combination(size, rate_hz, int(spec["odometry"]["window"]["max_keyframes"]), variant),
        listed["sequence"],
        listed["drive"],
        int(listed["seed"]),
        row,
        folder / REFERENCES,
    )


def _baseline(plan: Plan, runs: Sequence[StudyRun]) -> Combination:
    """The combination with the plan's values of the baseline, and with the first value of the other dimensions."""
    values: Dict[str, str] = {name: plan.baseline.get(name, each[0]) for name, each in plan.grid.items()}
    variant = " ".join(f"{name}={value}" for name, value in values.items() if name not in OF_THE_PAPER)
    for run in runs:
        combination = run.combination
        if (
            combination.variant == variant
            and combination.size == values.get("size", combination.size)
            and combination.rate_hz == float(values.get("fps", combination.rate_hz))
            and combination.window == int(values.get(WINDOW, combination.window))
        ):
            return combination
    return runs[0].combination
