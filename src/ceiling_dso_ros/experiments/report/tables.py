# SPDX-License-Identifier: BSD-3-Clause
"""Tables of a study: the paper's two, errors, changes against the baseline, failures, and all runs."""

from dataclasses import dataclass, field
from typing import Any, Dict, List, Mapping, NamedTuple, Optional, Sequence

import numpy as np
from tabulate import tabulate

from ceiling_dso_ros.experiments.report.statistics import change_of, spread_of
from ceiling_dso_ros.experiments.report.study import Combination, Study, StudyRun
from ceiling_dso_ros.experiments.sweep.answering import DONE
from ceiling_dso_ros.experiments.sweep.rows import csv_of
from ceiling_dso_ros.experiments.sweep.store import RUNS


class Cell(NamedTuple):
    """A value, and the runs that it is of.

    Attributes:
        text: the value.
        runs: names of the runs' folders.
        alarming: shows it as a failure.
    """

    text: str
    runs: Sequence[str] = ()
    alarming: bool = False


@dataclass(frozen=True)
class StudyTable:
    """A table of the report.

    Attributes:
        name: of its files, without the ending.
        caption: what it shows.
        headers: of the columns.
        rows: a cell for each column.
    """

    name: str
    caption: str
    headers: Sequence[str]
    rows: Sequence[Sequence[Cell]] = field(default_factory=list)

    def as_csv(self) -> bytes:
        """As CSV."""
        return csv_of([dict(zip(self.headers, (cell.text for cell in row))) for row in self.rows], self.headers)

    def as_latex(self) -> bytes:
        """As a LaTeX table for the package booktabs."""
        texts = [[cell.text for cell in row] for row in self.rows]
        return (tabulate(texts, self.headers, tablefmt="latex_booktabs", disable_numparse=True) + "\n").encode()


def study_tables(study: Study) -> List[StudyTable]:
    """All tables."""
    timed = all(run.row["timed"] for run in study.runs)
    how = "each run alone on a core" if timed else "runs beside each other: these are no measurements of speed"
    return [
        _paper(study, "time", "frame_ms", f"As the paper's table 1. Mean time for an image [ms], {how}."),
        _paper(study, "keyframes", "keyframe_share", "As the paper's table 2. Keyframes for each image."),
        _errors(study),
        _changes(study),
        _failures(study),
        _runs(study),
    ]


def _paper(study: Study, name: str, column: str, caption: str) -> StudyTable:
    """Sizes and rates by windows, over all sequences."""
    windows = study.values("window")
    variants = [*dict.fromkeys(each.variant for each in study.combinations)]
    rows = []
    for variant in variants:
        for size in study.values("size"):
            for rate_hz in study.values("rate_hz"):
                cells = [Cell(size), Cell(f"{rate_hz:g} Hz")] + [Cell(variant)] * (len(variants) > 1)
                for window in windows:
                    combination = Combination(size, rate_hz, window, variant)
                    cells.append(_cell(study.numbers(column, combination), study.of(combination)))
                rows.append(cells)
    headers = [
        "image size",
        "rate",
        *["other settings"] * (len(variants) > 1),
        *(f"{each} keyframes" for each in windows),
    ]
    return StudyTable(name, f"{caption} {_SPREAD}", headers, rows)


_SPREAD = "Median, and in brackets the smallest and the largest of all drives and seeds."


def _errors(study: Study) -> StudyTable:
    """RMSE and losses of every combination, by sequence."""
    headers = ["combination"]
    for sequence in study.sequences:
        headers += [f"{sequence}: ATE [mm]", f"{sequence}: % of the path", f"{sequence}: images with a pose"]
    rows = []
    for combination in study.combinations:
        cells = [Cell(str(combination))]
        for sequence in study.sequences:
            runs = study.of(combination, sequence)
            cells.append(_cell([1e3 * value for value in study.numbers("ate_m", combination, sequence)], runs))
            cells.append(Cell(spread_of(study.numbers("ate_percent", combination, sequence))))
            tracked = [100.0 * run.row["tracked"] / run.row["frames"] for run in runs]
            lost = sum(run.row["lost"] for run in runs)
            text = f"{spread_of(tracked)} %" + (f", lost {lost} times" if lost else "") if runs else "-"
            cells.append(Cell(text, alarming=bool(lost) or not runs))
        rows.append(cells)
    caption = f"RMSE of the final trajectory after a Sim(3) alignment of all of it. {_SPREAD} A run that was lost has "
    return StudyTable(
        "errors", f"{caption}several segments, each with its own unit, so that its error is large.", headers, rows
    )


def _changes(study: Study) -> StudyTable:
    """Ratios to the baseline."""
    measures = {"ATE": "ate_m", "time for an image": "frame_ms", "keyframes for each image": "keyframe_share"}
    base = {run.pair: run for run in study.of(study.baseline)}
    rows = []
    for combination in study.combinations:
        if combination == study.baseline:
            continue
        cells = [Cell(str(combination))]
        for column in measures.values():
            pairs = [(base[run.pair], run) for run in study.of(combination) if run.pair in base]
            known = [(b.number(column), a.number(column), a.name) for b, a in pairs]
            both = [(b, a, name) for b, a, name in known if b is not None and a is not None]
            change = change_of([b for b, _, _ in both], [a for _, a, _ in both])
            cells.append(Cell("-" if change is None else str(change), [name for _, _, name in both]))
        rows.append(cells)
    caption = (
        f"Value over that of the baseline ({study.baseline}): the median over pairs of the same drive and seed, and a "
        "95 % bootstrap interval where there are at least three pairs."
    )
    return StudyTable("changes", caption, ["combination", *measures], rows)


def _failures(study: Study) -> StudyTable:
    """Runs that are not done, have no pose, or were lost."""
    rows = []
    for run in study.runs:
        why = _why_bad(run.row)
        if why:
            words = f"{run.combination}, seed {run.seed}"
            rows.append([Cell(run.drive, [run.name]), Cell(words), Cell(why, alarming=True), Cell(run.row["message"])])
    caption = (
        "Runs that are not done, and runs that were lost or have no pose." if rows else "No run has failed or was lost."
    )
    return StudyTable("failures", caption, ["drive", "combination", "what happened", "last words"], rows)


def _why_bad(row: Mapping[str, Any]) -> str:
    if row["status"] != DONE:
        return str(row["status"])
    if not row["tracked"]:
        return "no pose"
    return f"lost {row['lost']} times" if row["lost"] else ""


def _runs(study: Study) -> StudyTable:
    """One row for each run."""
    columns: Dict[str, str] = {
        "status": "status", "ATE [m]": "ate_m", "% of the path": "ate_percent", "images": "frames",
        "with a pose": "tracked", "lost": "lost", "keyframes": "keyframes", "ms for an image": "frame_ms",
        "memory [MB]": "memory_mb",
    }  # fmt: skip
    rows = [
        [Cell(run.drive, [run.name]), Cell(str(run.combination)), Cell(str(run.seed))]
        + [Cell(_shown(run.row.get(column))) for column in columns.values()]
        for run in study.runs
    ]
    return StudyTable("runs", "All runs.", ["drive", "combination", "seed", *columns], rows)


def _cell(values: Sequence[float], runs: Sequence[StudyRun]) -> Cell:
    return Cell(spread_of(values), [run.name for run in runs], alarming=not len(values))


def _shown(value: Optional[Any]) -> str:  # noqa: ANN401
    if value is None:
        return "-"
    return f"{value:.4g}" if isinstance(value, (float, np.floating)) else str(value)


def link_of(run: str) -> str:
    """From the report to a run's folder."""
    return f"{RUNS}/{run}/"
