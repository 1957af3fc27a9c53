# SPDX-License-Identifier: BSD-3-Clause
"""Two studies, of two versions or two cameras, run by run."""

from collections import defaultdict
from dataclasses import dataclass
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np
from scipy.stats import binomtest, ttest_1samp
from tabulate import tabulate

from ceiling_dso_ros.experiments.report.statistics import Change, change_of
from ceiling_dso_ros.experiments.report.study import Study, StudyRun
from ceiling_dso_ros.io.errors import InputError

CHANCE = 1e-3  # a change that is at least as likely by chance is none: several measures are tested, and often
LEAST_CHANGE = 1.02  # a smaller one matters to nobody
LEAST_DRIVES = 4  # that are counted as one each; of fewer, each run counts
MEASURES = {"ATE": "ate_m", "live ATE": "live_ate_m", "fused ATE": "fused_ate_m", "time for an image": "frame_ms"}

Pair = Tuple[StudyRun, StudyRun]


@dataclass(frozen=True)
class Compared:
    """One measure, of which less is better.

    Attributes:
        name: of the measure.
        change: after over before; None if it is known of no pair.
        worse, better: probability of such a change by chance.
    """

    name: str
    change: Optional[Change]
    worse: float = 1.0
    better: float = 1.0

    @property
    def verdict(self) -> str:
        """What can be said."""
        if self.change is None:
            return "unknown"
        if self.worse < CHANCE and self.change.ratio > LEAST_CHANGE:
            return "WORSE"
        if self.better < CHANCE and self.change.ratio < 1.0 / LEAST_CHANGE:
            return "better"
        return "no change"


@dataclass(frozen=True)
class Comparison:
    """The result.

    Attributes:
        measures: all that were compared.
        pairs: of runs.
        left_out: runs without a partner.
        failed: runs that are not done, though their partners are.
        lost: pairs of which only the second was lost, and of which only the first was.
    """

    measures: Sequence[Compared]
    pairs: int
    left_out: int
    failed: Sequence[str]
    lost: Tuple[int, int]

    @property
    def lost_more(self) -> bool:
        """Whether more runs were lost than by chance."""
        after, before = self.lost
        return after > before and binomtest(after, after + before, 0.5, alternative="greater").pvalue < CHANCE

    @property
    def is_worse(self) -> bool:
        """Whether anything is worse beyond the spread."""
        return bool(self.failed) or self.lost_more or any(each.verdict == "WORSE" for each in self.measures)

    def __str__(self) -> str:
        """A table, and lines for what it does not show."""
        rows = [
            [
                each.name,
                "-" if each.change is None else str(each.change),
                f"{min(each.worse, each.better):.2g}",
                each.verdict,
            ]
            for each in self.measures
        ]
        headers = ["measure", "after / before", "by chance", "verdict"]
        lines = [tabulate(rows, headers, disable_numparse=True), ""]
        lines.append(
            f"{self.pairs} pairs of runs" + (f", {self.left_out} runs without a partner" if self.left_out else "")
        )
        after, before = self.lost
        lines.append(f"lost only after: {after}, only before: {before}{': WORSE' if self.lost_more else ''}")
        lines += [f"not done any more: {name}: WORSE" for name in self.failed]
        lines.append(
            "verdict: " + ("WORSE beyond the spread" if self.is_worse else "nothing is worse beyond the spread")
        )
        return "\n".join(lines)


def compare(before: Study, after: Study) -> Comparison:
    """Compare the runs that have the same sequence, recording, combination and seed.

    Times count only where all runs of both studies were alone on a core.

    Raises:
        InputError: no run has a partner.
    """
    pairs = _pairs(before, after)
    if not pairs:
        raise InputError(
            f"{before.folder} and {after.folder}: no run of one has the sequence and the settings of a run of the other"
        )
    timed = all(run.row["timed"] for pair in pairs for run in pair)
    done = [pair for pair in pairs if pair[0].is_done and pair[1].is_done]
    names = {name: column for name, column in MEASURES.items() if timed or column != "frame_ms"}
    return Comparison(
        [_compared(name, column, done) for name, column in names.items()],
        len(pairs),
        len(before.runs) + len(after.runs) - 2 * len(pairs),
        [b.name for a, b in pairs if a.is_done and not b.is_done],
        (
            sum(b.row["lost"] > 0 and not a.row["lost"] for a, b in done),
            sum(a.row["lost"] > 0 and not b.row["lost"] for a, b in done),
        ),
    )


def _pairs(before: Study, after: Study) -> List[Pair]:
    """By recording, where the two have recordings in common, else by sequence alone."""
    for whole in (True, False):
        found = {_key(run, whole): run for run in before.runs}
        pairs = [(found[_key(run, whole)], run) for run in after.runs if _key(run, whole) in found]
        if pairs:
            return pairs
    return []


def _key(run: StudyRun, whole: bool) -> Tuple[object, ...]:
    return (run.sequence, run.drive if whole else "", run.seed, run.combination)


def _compared(name: str, column: str, pairs: Sequence[Pair]) -> Compared:
    """A t-test of the logarithms; runs over the same images are not independent, so a drive counts once."""
    known: List[Tuple[float, float, Tuple[str, str, int]]] = []
    for a, b in pairs:
        first, second = a.number(column), b.number(column)
        if first and second:
            known.append((first, second, b.pair))
    change = change_of([first for first, _, _ in known], [second for _, second, _ in known])
    logs: Dict[object, List[float]] = defaultdict(list)
    for first, second, drive in known:
        logs[drive].append(float(np.log(second / first)))
    means = [float(np.mean(each)) for each in logs.values()]
    samples = means if len(means) >= LEAST_DRIVES else [value for each in logs.values() for value in each]
    if len(samples) < 2 or np.ptp(samples) == 0.0:
        certain = len(samples) > 1 and samples[0] != 0.0  # the same change in every run is no chance
        return Compared(name, change, *(0.0 if certain and sign * samples[0] > 0.0 else 1.0 for sign in (1, -1)))
    worse, better = (float(ttest_1samp(samples, 0.0, alternative=way).pvalue) for way in ("greater", "less"))
    return Compared(name, change, worse, better)
