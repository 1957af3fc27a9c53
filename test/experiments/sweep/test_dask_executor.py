# SPDX-License-Identifier: BSD-3-Clause
"""A study on a Dask cluster of two processes."""

import os
import signal
from pathlib import Path

import pytest

from ceiling_dso_ros.experiments.sweep import dask_executor
from ceiling_dso_ros.experiments.sweep.dask_executor import DaskExecutor
from ceiling_dso_ros.experiments.sweep.executors import Job
from ceiling_dso_ros.experiments.sweep.supervision import Limits
from ceiling_dso_ros.io.errors import InputError

distributed = pytest.importorskip("distributed")


# Each Dask worker, also one that takes the place of another, begins with this: the acting worker carries its runs out.
SETUP = """
import sys
sys.path.insert(0, {path!r})
from ceiling_dso_ros.experiments.sweep import supervision
supervision.SupervisedWorker.__init__.__defaults__ = ("acting_worker",)
"""


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory):
    setup = tmp_path_factory.mktemp("setup") / "setup.py"
    setup.write_text(SETUP.format(path=str(Path(__file__).parent)))
    options = {"dashboard_address": None, "threads_per_worker": 1, "processes": True, "preload": [str(setup)]}
    with distributed.LocalCluster(n_workers=2, **options) as cluster, distributed.Client(cluster) as client:
        yield cluster.scheduler_address, client


def carried_out(scheduler, specs, tmp_path, timed=False):
    folders = (tmp_path / f"run{number}" for number in range(len(specs)))

    def new_folder():
        folder = next(folders)
        folder.mkdir()
        return folder

    jobs = [Job(str(number), spec) for number, spec in enumerate(specs)]
    executor = DaskExecutor(scheduler[0], Limits(), timed)
    return sorted(executor.carry_out(jobs, new_folder), key=lambda ended: int(ended.job.name))


@pytest.mark.long
def test_results_come_back_and_failures_are_outcomes(scheduler, spec_of, tmp_path):
    specs = [spec_of(seed=seed) for seed in range(4)] + [spec_of("crash"), spec_of("fail"), spec_of("killed_once")]
    ended = carried_out(scheduler, specs, tmp_path)
    assert [each.outcome.status for each in ended] == [*["done"] * 4, "crashed", "failed", "done"]
    for seed, each in enumerate(ended[:4]):
        assert each.outcome.numbers == {"frames": 3 + seed}
        assert (each.folder / "camera.tum").read_text() == f"{seed}\n"
    assert "about to crash" in ended[4].outcome.message
    assert "about to crash" in (ended[4].folder / "log.txt").read_text()


@pytest.mark.long
def test_timed_runs_are_pinned(scheduler, spec_of, tmp_path):
    (ended,) = carried_out(scheduler, [spec_of("cores")], tmp_path, timed=True)
    assert ended.outcome.numbers == {"frames": 1, "keyframes": 1}


@pytest.mark.long
def test_another_version_is_refused(scheduler, spec_of, tmp_path, monkeypatch):
    monkeypatch.setattr(dask_executor, "code_digest", lambda: "another")
    with pytest.raises(InputError, match="has another version"):
        carried_out(scheduler, [spec_of()], tmp_path)


@pytest.mark.long
def test_a_dask_worker_that_is_killed_costs_a_retry(scheduler, spec_of, tmp_path):
    pids = [*scheduler[1].run(os.getpid).values()]
    specs = [spec_of(seed=seed) for seed in range(20)]
    ended = []
    folders = iter(range(len(specs)))

    def new_folder():
        folder = tmp_path / f"of{next(folders)}"
        folder.mkdir()
        return folder

    executor = DaskExecutor(scheduler[0], Limits(), False)
    for each in executor.carry_out([Job(str(spec.seed), spec) for spec in specs], new_folder):
        if not ended:
            os.kill(pids[0], signal.SIGKILL)
        ended.append(each)
    assert {each.outcome.status for each in ended} == {"done"}
    assert {each.outcome.numbers["frames"] - 3 for each in ended} == set(range(20))
