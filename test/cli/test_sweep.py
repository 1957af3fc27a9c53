# SPDX-License-Identifier: BSD-3-Clause
"""A study as users call it, with the odometry."""

import csv
import json

import pytest

from ceiling_dso_ros.cli.main import main
from ceiling_dso_ros.experiments.sweep.rows import VOLATILE

TRAJECTORIES = ("camera.tum", "camera_final.tum", "keyframes.tum")


@pytest.fixture(scope="module")
def folder(tum_folder_of_module):
    stamps = [line.split()[1] for line in (tum_folder_of_module / "times.txt").read_text().splitlines()]
    lines = (f"{stamp} {0.02 * index} {1e-4 * index**2} 0 0 0 0 1\n" for index, stamp in enumerate(stamps))
    (tum_folder_of_module / "groundtruth.tum").write_text("".join(lines))
    return tum_folder_of_module


def rows_of(study):
    with (study / "runs.csv").open() as file:
        return [{name: text for name, text in row.items() if name not in VOLATILE} for row in csv.DictReader(file)]


def trajectories_of(study):
    return {
        path.relative_to(study): path.read_bytes() for name in TRAJECTORIES for path in study.glob(f"runs/*/{name}")
    }


@pytest.mark.long
def test_one_process_and_a_cluster_of_two_give_the_same_bytes(folder, command, tmp_path):
    distributed = pytest.importorskip("distributed")
    grid = ("--grid", "fps=15,30", "--set", "noise=1")
    result = command("sweep", folder, "--out", tmp_path / "one", *grid, "--jobs", 1)
    assert result.returncode == 0, result.stderr
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        address = cluster.scheduler_address
        assert command("sweep", folder, "--out", tmp_path / "dask", *grid, "--scheduler", address).returncode == 0
    assert len(trajectories_of(tmp_path / "one")) == 2 * len(TRAJECTORIES)
    assert trajectories_of(tmp_path / "dask") == trajectories_of(tmp_path / "one")
    assert rows_of(tmp_path / "dask") == rows_of(tmp_path / "one")
    assert [row["frames"] for row in rows_of(tmp_path / "one")] == ["20", "40"]
    assert 0.0 < float(rows_of(tmp_path / "one")[1]["ate_m"]) < 0.05
    assert (tmp_path / "one" / "report.html").exists()
    run = json.loads(next((tmp_path / "one" / "runs").glob("*/run.json")).read_text())
    assert run["spec"]["conditions"]["noise"] == 1.0


def sweep(*words):
    return main(["sweep", *map(str, words)])


def test_the_plan_is_printed(folder, tmp_path, capsys):
    assert sweep(folder, "--out", tmp_path / "out", "--grid", "fps=15,30", "--seeds", 2, "--dry-run") == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(" ", 1)[1].split(":")[0].strip() for line in lines[:2]] == [
        "tour tour fps=15 seed=0", "tour tour fps=15 seed=1",
    ]  # fmt: skip
    assert lines[-1] == "4 runs, 4 of them to be carried out"
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--grid", "fps"], "--grid fps: expected key=value,value"),
        (["--grid", "fsp=3"], "fsp is unknown"),
        (["--jobs", "0"], "--jobs 0: at least 1"),
        (["--baseline", "fps=3"], "baseline fps=3: is not in the grid"),
    ],
)
def test_wrong_usage_is_one_line(folder, tmp_path, capsys, words, message):
    assert sweep(folder, "--out", tmp_path / "out", *words) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: ")
    assert said.count("\n") == 1
    assert message in said
