# SPDX-License-Identifier: BSD-3-Clause
"""Where runs are carried out: processes of this machine."""

import os
import queue
import socket
import threading
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Callable, Iterator, List, Optional, Sequence, Union

from ceiling_dso_ros.experiments.sweep.run_spec import RunSpec
from ceiling_dso_ros.experiments.sweep.supervision import Limits, Outcome, SupervisedWorker


@dataclass(frozen=True)
class Job:
    """A run that is to be carried out.

    Attributes:
        name: of the run.
        spec: of the run.
    """

    name: str
    spec: RunSpec


@dataclass(frozen=True)
class Ended:
    """A run that has ended.

    Attributes:
        job: what was to be done.
        outcome: how it ended.
        folder: its files.
        host: where it was carried out.
    """

    job: Job
    outcome: Outcome
    folder: Path
    host: str


class Executor(ABC):
    """Carries runs out."""

    @abstractmethod
    def carry_out(self, jobs: Sequence[Job], new_folder: Callable[[], Path]) -> Iterator[Ended]:
        """Carry out all jobs, in any order; each is yielded when it has ended.

        Args:
            jobs: those that begin first are first.
            new_folder: makes an empty folder.
        """


class LocalExecutor(Executor):
    """This machine: untimed runs in parallel, or timed ones alone on a core."""

    def __init__(self, jobs: int, limits: Limits, timed: bool, tell: Callable[[str], None]) -> None:
        """Choose how many runs are carried out at once; timed ones always one by one."""
        self._limits, self._timed, self._tell = limits, timed, tell
        available = sorted(os.sched_getaffinity(0))
        self._cores = available[-1:] if timed else available
        self._workers = 1 if timed else jobs

    def carry_out(self, jobs: Sequence[Job], new_folder: Callable[[], Path]) -> Iterator[Ended]:
        """See Executor."""
        waiting: queue.SimpleQueue[Optional[Job]] = queue.SimpleQueue()
        ended: queue.SimpleQueue[Union[Ended, BaseException]] = queue.SimpleQueue()
        count = min(self._workers, len(jobs))
        for job in [*jobs, *[None] * count]:
            waiting.put(job)
        workers = [SupervisedWorker(self._limits) for _ in range(count)]
        threads = [
            threading.Thread(target=self._work, args=(worker, waiting, ended, new_folder), daemon=True)
            for worker in workers
        ]
        try:
            for worker in workers[:1]:
                worker.prepare(self._tell)  # before the others, or each would compile the kernels
            for thread in threads:
                thread.start()
            for _ in jobs:
                result = ended.get()
                if isinstance(result, BaseException):
                    raise result
                yield result
        finally:
            _drain(waiting)
            for worker in workers:
                worker.close()

    def _work(
        self,
        worker: SupervisedWorker,
        waiting: "queue.SimpleQueue[Optional[Job]]",
        ended: "queue.SimpleQueue[Union[Ended, BaseException]]",
        new_folder: Callable[[], Path],
    ) -> None:
        try:
            for job in iter(waiting.get, None):
                folder = new_folder()
                outcome = worker.run(job.spec.as_json(), folder, self._timed, self._cores)
                ended.put(Ended(job, outcome, folder, socket.gethostname()))
        except BaseException as error:
            ended.put(error)


def _drain(waiting: "queue.SimpleQueue[Optional[Job]]") -> None:
    jobs: List[Optional[Job]] = []
    while not waiting.empty():
        jobs.append(waiting.get())
    waiting.put(None)
