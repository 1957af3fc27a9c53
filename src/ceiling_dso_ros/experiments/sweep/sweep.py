# SPDX-License-Identifier: BSD-3-Clause
"""Carries a study out: what has ended before is kept, what is missing is run."""

import time
from dataclasses import dataclass
from typing import Any, Callable, Dict, List, Optional, Sequence

from ceiling_dso_ros.experiments.sweep.answering import DONE
from ceiling_dso_ros.experiments.sweep.executors import Ended, Executor, Job
from ceiling_dso_ros.experiments.sweep.plan import Plan
from ceiling_dso_ros.experiments.sweep.run_spec import RunSpec
from ceiling_dso_ros.experiments.sweep.store import Store

TABLE_S = 10.0  # how often runs.csv is written


@dataclass(frozen=True)
class PlannedRun:
    """A run of the plan.

    Attributes:
        name: of its folder.
        spec: of the run.
        row: what is known of it; None if it is still to be carried out.
    """

    name: str
    spec: RunSpec
    row: Optional[Dict[str, Any]]

    def as_row(self) -> Dict[str, Any]:
        """A row of runs.csv."""
        keys = {"run": self.name, "sequence": self.spec.sequence, "drive": self.spec.drive, "seed": self.spec.seed}
        return {**keys, **self.spec.varied, **(self.row or {})}


def planned(plan: Plan, store: Store, timed: bool, retry_failed: bool) -> List[PlannedRun]:
    """All runs of a plan, with what is known of them.

    Args:
        plan: the study.
        store: its folder, which need not exist.
        timed: runs that were not measured alone on a core are to be carried out again.
        retry_failed: those that are not done, too.

    Raises:
        InputError: a recording or a value cannot be used.
    """
    runs = []
    for spec in plan.runs():
        name = spec.name()
        row = store.row(name)
        if row is not None and ((timed and not row["timed"]) or (retry_failed and row["status"] != DONE)):
            row = None
        runs.append(PlannedRun(name, spec, row))
    return runs


def carry_out(
    plan: Plan, runs: Sequence[PlannedRun], store: Store, executor: Executor, timed: bool,
    tell: Callable[[PlannedRun], None],
) -> List[PlannedRun]:  # fmt: skip
    """Carry out what is missing, and write runs.csv.

    Args:
        plan: the study.
        runs: of the plan.
        store: its folder, locked.
        executor: carries them out.
        timed: the executor carries them out one by one on a core.
        tell: is given each run when it has ended.

    Returns:
        All runs, in the order of the plan.

    Raises:
        OutputError: the folder cannot be written to.
    """
    for reference in {spec.reference for spec in (run.spec for run in runs) if spec.reference is not None}:
        store.keep_reference(reference)
    missing = {run.name: Job(run.name, run.spec) for run in runs if run.row is None}
    ended: Dict[str, Dict[str, Any]] = {run.name: run.row for run in runs if run.row is not None}
    largest_first = sorted(missing.values(), key=lambda job: -job.spec.work())
    written_s = time.monotonic()

    def now() -> List[PlannedRun]:
        return [PlannedRun(run.name, run.spec, ended.get(run.name)) for run in runs]

    def write() -> None:
        store.write_table(plan, [run.as_row() for run in now() if run.row is not None])

    try:
        for result in executor.carry_out(largest_first, store.unfinished):
            ended[result.job.name] = _keep(store, result, timed)
            tell(PlannedRun(result.job.name, result.job.spec, ended[result.job.name]))
            if time.monotonic() - written_s > TABLE_S:
                write()
                written_s = time.monotonic()
    finally:
        write()
    return now()


def _keep(store: Store, ended: Ended, timed: bool) -> Dict[str, Any]:
    return store.keep(ended.job.name, ended.job.spec, ended.outcome, ended.folder, timed, ended.host)
