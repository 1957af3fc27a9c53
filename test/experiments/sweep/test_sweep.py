# SPDX-License-Identifier: BSD-3-Clause
"""A study from its plan to runs.csv, with a process that acts instead of the odometry."""

import csv
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from ceiling_dso_ros.experiments.sweep.executors import LocalExecutor
from ceiling_dso_ros.experiments.sweep.plan import Plan
from ceiling_dso_ros.experiments.sweep.rows import VOLATILE
from ceiling_dso_ros.experiments.sweep.store import Store
from ceiling_dso_ros.experiments.sweep.supervision import Limits
from ceiling_dso_ros.experiments.sweep.sweep import carry_out, planned
from ceiling_dso_ros.io.errors import InputError

pytestmark = pytest.mark.usefixtures("acting")


@pytest.fixture
def drive(tmp_path):
    path = tmp_path / "drive.bag"
    path.write_text("a drive")
    return str(path)


def study(plan, folder, jobs=1, timed=False, retry_failed=False, limits=Limits()):
    store, told = Store(folder), []
    with store.locked():
        runs = planned(plan, store, timed, retry_failed)
        executor = LocalExecutor(jobs, limits, timed, told.append)
        runs = carry_out(plan, runs, store, executor, timed, told.append)
    return runs, told


def table(folder, volatile=False):
    with (folder / "runs.csv").open() as file:
        return [{k: v for k, v in row.items() if volatile or k not in VOLATILE} for row in csv.DictReader(file)]


def test_all_combinations_in_the_order_of_the_plan(drive, tmp_path):
    grid = {"fps": ["15", "3"], "window.max_keyframes": ["7", "5"]}
    runs, told = study(Plan({"tour": [drive]}, grid, seeds=2), tmp_path / "out", jobs=2)
    rows = table(tmp_path / "out")
    assert [(row["fps"], row["window.max_keyframes"], row["seed"]) for row in rows] == [
        (fps, size, seed) for fps in ("15", "3") for size in ("7", "5") for seed in ("0", "1")
    ]
    assert {row["status"] for row in rows} == {"done"}
    assert [row["frames"] for row in rows] == ["3", "4"] * 4
    assert len(told) == 8
    for run in runs:
        assert (tmp_path / "out" / "runs" / run.name / "camera.tum").exists()


def test_what_has_ended_is_not_done_again(drive, tmp_path):
    plan = Plan({"tour": [drive]}, {"fps": ["15"]})
    study(plan, tmp_path / "out")
    before = table(tmp_path / "out", volatile=True)
    _, told = study(replace(plan, grid={"fps": ["15", "3"]}), tmp_path / "out")
    assert len(told) == 1
    assert table(tmp_path / "out", volatile=True)[:1] == before


def test_a_run_belongs_to_contents_settings_and_seed(drive, tmp_path, spec_of):
    spec = spec_of()
    names = {spec.name(), replace(spec, seed=1).name()}
    names.add(replace(spec, conditions=replace(spec.conditions, blur=1.0)).name())
    names.add(
        replace(spec, odometry=replace(spec.odometry, images=replace(spec.odometry.images, max_noise=1.0))).name()
    )
    assert len(names) == 4
    elsewhere = tmp_path / "elsewhere.bag"
    elsewhere.write_text("a drive")
    assert replace(spec, input=str(elsewhere)).name() == spec.name()
    elsewhere.write_text("another")
    assert replace(spec, input=str(elsewhere)).name() not in names


def test_failures_are_rows_and_are_retried_when_asked_for(drive, tmp_path):
    plan = Plan({name: [drive] for name in ("crash", "fail", "drive")}, {"fps": ["15"]})
    # One path: the same contents would be one run.
    plans = {}
    for number, name in enumerate(plan.inputs):
        path = tmp_path / f"{name}.bag"
        path.write_text(f"drive {number}")
        plans[name] = [str(path)]
    plan = replace(plan, inputs=plans)
    study(plan, tmp_path / "out")
    assert [row["status"] for row in table(tmp_path / "out")] == ["crashed", "failed", "done"]
    assert study(plan, tmp_path / "out")[1] == []
    assert len(study(plan, tmp_path / "out", retry_failed=True)[1]) == 2


def test_timed_runs_replace_untimed_ones(drive, tmp_path):
    plan = Plan({"tour": [drive]}, {"fps": ["15"]})
    study(plan, tmp_path / "out")
    assert len(study(plan, tmp_path / "out", timed=True)[1]) == 1
    assert [row["timed"] for row in table(tmp_path / "out")] == ["true"]
    assert study(plan, tmp_path / "out")[1] == []


def test_two_sweeps_do_not_write_into_one_folder(tmp_path):
    with Store(tmp_path / "out").locked():
        another = Store(tmp_path / "out").locked()
        with pytest.raises(InputError, match="another sweep writes there"):
            another.__enter__()


SWEEP = """
import sys
sys.path[:0] = {paths!r}
import test_sweep
from ceiling_dso_ros.experiments.sweep import plan, supervision
supervision.SupervisedWorker.__init__.__defaults__ = ("acting_worker",)
plan.Plan._references = lambda self, path: (None, None)
from pathlib import Path
test_sweep.study(plan.Plan({{"tour": [{drive!r}]}}, seeds=200), Path({out!r}), jobs=2)
"""


@pytest.mark.long
def test_killed_at_any_moment_it_goes_on(drive, tmp_path):
    plan = Plan({"tour": [drive]}, seeds=200)
    study(plan, tmp_path / "whole")
    out = tmp_path / "out"
    paths = [str(Path(__file__).parent), *sys.path]
    script = SWEEP.format(paths=paths, drive=drive, out=str(out))
    for ended in (1, 60):
        process = subprocess.Popen([sys.executable, "-c", script])
        while process.poll() is None and len([*out.glob("runs/*")]) < ended:
            time.sleep(0.01)
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        assert ended <= len([*out.glob("runs/*")]) < 200
    assert len(study(plan, out)[1]) <= 140
    assert table(out) == table(tmp_path / "whole")
    assert sorted(path.name for path in out.iterdir()) == sorted(path.name for path in (tmp_path / "whole").iterdir())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"grid": {"fsp": ["3"]}}, "fsp is unknown"),
        ({"grid": {"fps": ["-3"]}}, "fps=-3: 0 to 1000"),
        ({"grid": {"size": ["tall"]}}, "expected WIDTHxHEIGHT"),
        ({"grid": {"window.max_keyframes": ["many"]}}, "window.max_keyframes"),
        ({"constant": {"fusion.graph.window": "3"}}, "graph.window"),
    ],
)
def test_wrong_values_are_found_before_the_first_run(drive, tmp_path, changes, message):
    with pytest.raises(InputError, match=message):
        study(replace(Plan({"tour": [drive]}), **changes), tmp_path / "out")
