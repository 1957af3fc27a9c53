# SPDX-License-Identifier: BSD-3-Clause
"""Carries runs out on a Dask cluster, whose workers have this package and read the recordings under the same paths."""

import os
import socket
import tempfile
import threading
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, List, Sequence, Tuple
from urllib.parse import urlsplit

from ceiling_dso_ros.experiments.sweep.executors import Ended, Executor, Job
from ceiling_dso_ros.experiments.sweep.run_spec import code_digest
from ceiling_dso_ros.experiments.sweep.supervision import TRIES, Limits, Outcome, SupervisedWorker
from ceiling_dso_ros.io.errors import InputError

CONNECT_S = 30.0
Files = Dict[str, bytes]

# Of a Dask worker: a process for runs for each of its threads, which lasts until the study ends.
_workers: Dict[Tuple[int, Limits], SupervisedWorker] = {}
_alone = threading.Lock()


class DaskExecutor(Executor):
    """A cluster: untimed runs on all threads of all workers, timed ones one at a time on each host."""

    def __init__(self, address: str, limits: Limits, timed: bool) -> None:
        """Take the scheduler's address, such as tcp://10.0.0.1:8786."""
        self._address, self._limits, self._timed = address, limits, timed

    def carry_out(self, jobs: Sequence[Job], new_folder: Callable[[], Path]) -> Iterator[Ended]:
        """See Executor.

        Raises:
            InputError: there is no scheduler or no worker, or a worker has another version of the code.
        """
        from distributed import as_completed

        with self._connected() as client:
            hosts = self._one_worker_of_each_host(client)
            prepared = [
                client.submit(_prepare, self._limits, code_digest(), workers=[each], pure=False) for each in hosts
            ]
            client.gather(prepared)
            place = {"workers": hosts, "allow_other_workers": False} if self._timed else {}
            jobs_of = {}
            futures = []
            for job in jobs:
                arguments = job.spec.as_json(), self._limits, self._timed, code_digest()
                future = client.submit(_carry_out, *arguments, pure=False, retries=TRIES - 1, **place)
                jobs_of[future.key] = job
                futures.append(future)
            try:
                for future in as_completed(futures):
                    yield _ended(jobs_of[future.key], future, new_folder())
                    future.release()  # its files are here now
            finally:
                client.cancel(futures)
                client.run(_close_workers)

    def _connected(self) -> Any:  # noqa: ANN401
        from distributed import Client

        try:
            return Client(self._address, timeout=CONNECT_S)
        except (OSError, ValueError) as error:
            raise InputError(f"--scheduler {self._address}: {error or 'no answer'}") from error

    def _one_worker_of_each_host(self, client: Any) -> List[str]:  # noqa: ANN401
        hosts: Dict[str, str] = {}
        for address in sorted(client.scheduler_info()["workers"]):
            hosts.setdefault(str(urlsplit(address).hostname), address)
        if not hosts:
            raise InputError(f"--scheduler {self._address}: has no workers; start some with `dask worker ADDRESS`")
        return [*hosts.values()]


def _ended(job: Job, future: Any, folder: Path) -> Ended:  # noqa: ANN401
    """Fetch the result of a task."""
    try:
        outcome, files, host = future.result()
    except InputError:
        raise
    except Exception as error:  # the worker died again and again, or the cluster has lost the task
        return Ended(job, Outcome("crashed", f"{type(error).__name__}: {error}"), folder, "")
    for name, content in files.items():
        (folder / name).write_bytes(content)
    return Ended(job, outcome, folder, host)


def _prepare(limits: Limits, code: str) -> None:
    """Compile the kernels on the host of this worker."""
    _require_same(code)
    _worker(limits).prepare(print)


def _carry_out(spec: Dict[str, Any], limits: Limits, timed: bool, code: str) -> Tuple[Outcome, Files, str]:
    """The task: a run in a process of its own, and the contents of its files."""
    _require_same(code)
    worker = _worker(limits)
    cores = sorted(os.sched_getaffinity(0))
    with tempfile.TemporaryDirectory(prefix="ceiling_dso_") as folder:
        if timed:
            with _alone:
                outcome = worker.run(spec, Path(folder), timed, cores[-1:])
        else:
            outcome = worker.run(spec, Path(folder), timed, cores)
        files = {path.name: path.read_bytes() for path in Path(folder).iterdir()}
    return outcome, files, socket.gethostname()


def _worker(limits: Limits) -> SupervisedWorker:
    """That of this thread."""
    return _workers.setdefault((threading.get_ident(), limits), SupervisedWorker(limits))


def _require_same(code: str) -> None:
    if code != code_digest():
        raise InputError(f"the worker on {socket.gethostname()} has another version of this package or its libraries")


def _close_workers() -> None:
    while _workers:
        _workers.popitem()[1].close()
