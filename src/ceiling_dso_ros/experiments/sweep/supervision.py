# SPDX-License-Identifier: BSD-3-Clause
"""Runs in a process of their own, which may crash, hang or take too much memory."""

import contextlib
import json
import os
import select
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, Callable, Dict, List, Optional, Sequence

from ceiling_dso_ros.experiments.sweep.answering import LOG, READY
from ceiling_dso_ros.io.errors import one_line

# A single thread for a run: as on the robot, and so that runs beside each other do not wait for each other.
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
WORKER = "ceiling_dso_ros.experiments.sweep.worker"
POLL_S = 0.1
PATIENCE_S = 20.0  # for a process that has nothing to compile
START_LIMIT_S = 900.0  # compiling all kernels takes some minutes on a slow computer
PAGE = os.sysconf("SC_PAGE_SIZE")
LAST_WORDS = 5  # lines of a log
TRIES = 2  # of a run whose process dies: it may have been killed for another's sake


@dataclass(frozen=True)
class Limits:
    """What a run may take.

    Attributes:
        time_s: seconds.
        memory_mb: resident memory of its process.
    """

    time_s: float = 7200.0
    memory_mb: float = 4000.0


@dataclass(frozen=True)
class Outcome:
    """How a run ended.

    Attributes:
        status: done; failed (an error), crashed (the process died), hung or starved (beyond a limit).
        message: its last words, empty if it is done.
        numbers: of the run, empty unless it is done.
        tries: how often it was begun.
    """

    status: str
    message: str = ""
    numbers: Dict[str, Any] = field(default_factory=dict)
    tries: int = 1


class SupervisedWorker:
    """A process for runs, one after the other; it is started when it is needed, and again after it has ended."""

    def __init__(self, limits: Limits, module: str = WORKER) -> None:
        self._limits, self._module = limits, module
        self._process: Optional[subprocess.Popen] = None
        self._is_ready = False
        self._errors: Optional[IO[str]] = None

    def prepare(self, tell: Callable[[str], None]) -> None:
        """Start the process, which compiles the kernels where they are missing; tell is told if that takes long."""
        process = self._process or self._start()
        if not _can_read(process, PATIENCE_S):
            tell("waiting for the kernels, which are compiled where they are missing: a minute or two the first time")
            _can_read(process, START_LIMIT_S)

    def run(self, spec: Dict[str, Any], folder: Path, timed: bool, cores: Sequence[int]) -> Outcome:
        """Carry out a run.

        Args:
            spec: RunSpec.as_json.
            folder: an empty one for its files.
            timed: measure the machine's unit, too.
            cores: that it may use.
        """
        job = {"spec": spec, "folder": str(folder), "timed": timed, "cores": list(cores)}
        outcome = Outcome("crashed")
        for tries in range(1, TRIES + 1):
            outcome = Outcome(**{**self._try(job).__dict__, "tries": tries})
            if outcome.status != "crashed":
                break
        return outcome

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            for stream in (self._process.stdin, self._process.stdout, self._errors):
                with contextlib.suppress(OSError):
                    if stream is not None:
                        stream.close()
        self._process, self._is_ready = None, False

    def _try(self, job: Dict[str, Any]) -> Outcome:
        try:
            process = self._ready()
            if process is None:
                return self._ended(Outcome("crashed", f"no process for runs could be started: {self._said()}"))
            assert process.stdin is not None
            process.stdin.write(f"{json.dumps(job)}\n")
            process.stdin.flush()
        except BrokenPipeError:
            return self._ended(Outcome("crashed", "the process ended between two runs"))
        return self._supervise(process, Path(job["folder"]) / LOG)

    def _supervise(self, process: subprocess.Popen, log: Path) -> Outcome:
        begin_s = time.monotonic()
        while not _can_read(process, POLL_S):
            memory_mb = _resident_mb(process.pid)
            if memory_mb > self._limits.memory_mb:
                text = f"{memory_mb:.0f} MB are more than the {self._limits.memory_mb:g} MB that a run may take"
                return self._ended(Outcome("starved", _with_last_words(text, log)))
            if time.monotonic() - begin_s > self._limits.time_s:
                text = f"not done after {self._limits.time_s:g} s"
                return self._ended(Outcome("hung", _with_last_words(text, log)))
        assert process.stdout is not None
        line = process.stdout.readline()
        if not line:
            code = process.wait()
            text = f"killed by signal {-code}" if code < 0 else f"the process ended with exit code {code}"
            return self._ended(Outcome("crashed", _with_last_words(text, log)))
        return Outcome(**json.loads(line))

    def _ready(self) -> Optional[subprocess.Popen]:
        """The process, None if it does not get ready."""
        process = self._process or self._start()
        if self._is_ready:
            return process
        assert process.stdout is not None
        self._is_ready = _can_read(process, START_LIMIT_S) and process.stdout.readline().strip() == READY
        return process if self._is_ready else None

    def _start(self) -> subprocess.Popen:
        self._errors = tempfile.TemporaryFile("w+")  # noqa: SIM115  # closed with the process
        path = os.pathsep.join(path for path in sys.path if path)
        self._process = subprocess.Popen(
            [sys.executable, "-m", self._module],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._errors, text=True,
            env={**os.environ, **ONE_THREAD, "PYTHONPATH": path},
        )  # fmt: skip
        return self._process

    def _ended(self, outcome: Outcome) -> Outcome:
        """Do not use the process again."""
        self.close()
        return outcome

    def _said(self) -> str:
        if self._errors is None:
            return ""
        self._errors.seek(0)
        return _last_words(self._errors.read().splitlines())


def _can_read(process: subprocess.Popen, timeout_s: float) -> bool:
    return bool(select.select([process.stdout], [], [], timeout_s)[0])


def _resident_mb(pid: int) -> float:
    """Memory of a process, 0 if it has ended."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * PAGE / 2**20
    except (OSError, IndexError):
        return 0.0


def _with_last_words(text: str, log: Path) -> str:
    try:
        words = _last_words(log.read_text(errors="replace").splitlines())
    except OSError:
        words = ""
    return one_line(f"{text}; its last words: {words}" if words else text)


def _last_words(lines: List[str]) -> str:
    """The last lines; of a crash the line before it, what it was, and where."""
    said = [line.strip() for line in lines if line.strip()]
    crashes = [number for number, line in enumerate(said) if line.startswith("Fatal Python error")]
    first = max(0, crashes[-1] - 1) if crashes else max(0, len(said) - LAST_WORDS)
    return " | ".join(said[first : first + LAST_WORDS])
