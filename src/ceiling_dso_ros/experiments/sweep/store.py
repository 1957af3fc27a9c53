# SPDX-License-Identifier: BSD-3-Clause
"""Folder of a study: a folder for each run that has ended, and tables of all."""

import contextlib
import fcntl
import json
import os
import shutil
import tempfile
from pathlib import Path
from typing import IO, Any, Dict, Iterator, Optional, Sequence

from ceiling_dso_ros.experiments.sweep.plan import Plan
from ceiling_dso_ros.experiments.sweep.rows import columns, csv_of
from ceiling_dso_ros.experiments.sweep.run_spec import DIGITS, RunSpec, content_digest
from ceiling_dso_ros.experiments.sweep.supervision import Outcome
from ceiling_dso_ros.io.errors import InputError, OutputError, reason_of
from ceiling_dso_ros.io.replacing import replace_file

RUNS, REFERENCES, UNFINISHED, LOCK = "runs", "references", "unfinished", ".lock"
ROW, TABLE, PLAN = "run.json", "runs.csv", "plan.yaml"


class Store:
    """A study's folder.

    A run's folder gets its name when it is complete, so that after an interruption at any moment each run is there
    whole or not at all.
    """

    def __init__(self, folder: Path) -> None:
        """Take an existing or a new folder."""
        self.folder = folder

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """Keep others from writing, and remove what an interruption has left.

        Raises:
            InputError: another process writes.
            OutputError: the folder cannot be written to.
        """
        with _writing(self.folder):
            for name in (RUNS, REFERENCES):
                (self.folder / name).mkdir(parents=True, exist_ok=True)
            lock: IO[bytes] = (self.folder / LOCK).open("wb")
        with lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                raise InputError(f"{self.folder}: another sweep writes there; choose another --out") from error
            shutil.rmtree(self.folder / UNFINISHED, ignore_errors=True)
            with _writing(self.folder):
                (self.folder / UNFINISHED).mkdir(exist_ok=True)
            yield
            shutil.rmtree(self.folder / UNFINISHED, ignore_errors=True)

    def unfinished(self) -> Path:
        """A new empty folder for a run."""
        return Path(tempfile.mkdtemp(dir=self.folder / UNFINISHED))

    def row(self, name: str) -> Optional[Dict[str, Any]]:
        """What is known of a run that has ended; None if it has not."""
        path = self.folder / RUNS / name / ROW
        if not path.exists():
            return None
        row: Dict[str, Any] = json.loads(path.read_text())["row"]
        return row

    def keep(self, name: str, spec: RunSpec, outcome: Outcome, files: Path, timed: bool, host: str) -> Dict[str, Any]:
        """Take over a run that has ended.

        Args:
            name: of the run.
            spec: of the run.
            outcome: how it ended.
            files: folder of `unfinished`, which is moved.
            timed: it was alone on its core.
            host: where it was carried out.

        Raises:
            OutputError: the folder cannot be written to.
        """
        row = {
            "status": outcome.status, "message": outcome.message, "tries": outcome.tries, "timed": timed, "host": host,
            "reference": None if spec.reference is None else self._reference_name(spec.reference), **outcome.numbers,
        }  # fmt: skip
        content = json.dumps({"spec": spec.as_json(), "row": row}, indent=1, allow_nan=False) + "\n"
        replace_file(files / ROW, content.encode(), "the run")
        goal = self.folder / RUNS / name
        with _writing(goal):
            files.chmod(0o755)
            if goal.exists():
                goal.rename(self.unfinished() / "replaced")
            files.rename(goal)
            _sync(goal.parent)
        return row

    def keep_reference(self, path: str) -> None:
        """Copy a reference to the study, so that a report needs nothing else."""
        goal = self.folder / REFERENCES / self._reference_name(path)
        if not goal.exists():
            replace_file(goal, Path(path).read_bytes(), "the reference")

    @staticmethod
    def _reference_name(path: str) -> str:
        return f"{content_digest(path)[:DIGITS]}.tum"

    def write_table(self, plan: Plan, rows: Sequence[Dict[str, Any]]) -> None:
        """Write runs.csv and plan.yaml.

        Raises:
            OutputError: they cannot be written.
        """
        replace_file(self.folder / PLAN, plan.as_yaml(), "the plan")
        replace_file(self.folder / TABLE, csv_of(rows, columns([*plan.grid])), "the table")


@contextlib.contextmanager
def _writing(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise OutputError(f"{path}: cannot write there: {reason_of(error)}") from error


def _sync(folder: Path) -> None:
    """Have the system write the names in a folder to the disk."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
