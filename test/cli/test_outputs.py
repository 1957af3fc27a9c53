# SPDX-License-Identifier: BSD-3-Clause
"""Outputs are tried before the work; each file is written whole or not at all, whatever becomes of the others."""

import json
import os
import resource
import signal

import numpy as np
import pytest

from ceiling_dso_ros.cli.main import main
from ceiling_dso_ros.dso import warmup
from ceiling_dso_ros.fusion import calibration
from ceiling_dso_ros.io import bag_trajectories, bag_writer, trajectory
from ceiling_dso_ros.io.bag_writer import BagWriter
from ceiling_dso_ros.io.trajectory import Trajectory, read_tum, write_tum
from ceiling_dso_ros.lens import calibrating
from ceiling_dso_ros.playback import visual_run

RUN_FILES = {"camera.tum", "camera_final.tum", "keyframes.tum", "map.ply", "timing.csv", "summary.json", "config.yaml"}
EVALUATION_FILES = {"evaluation.json", "trajectory.png", "trajectory.svg", "error.png", "error.svg"}
SIMULATE = ("simulate", "square", "--ceiling", "plaster", "--size", "104x64", "--duration", "1")


def names(folder):
    return {path.name for path in folder.iterdir()}


@pytest.fixture
def out(tmp_path):
    folder = tmp_path / "results"
    folder.mkdir()
    return folder


@pytest.fixture
def published(tmp_path):
    """A bag with the output of the nodes."""
    path = tmp_path / "published.bag"
    with BagWriter(path) as bag:
        for topic in ("/odometry/filtered", "/wheel/odometry"):
            for second in range(1, 4):
                bag.odometry(topic, second * 10**9, "odom", "base_link", np.eye(4), np.zeros(3), np.zeros(3))
    return path


@pytest.fixture
def compared(tmp_path):
    """A folder with a trajectory beside its reference."""
    t = np.arange(0.0, 10.0, 0.1)
    positions = np.stack([3.0 * np.sin(t), 2.0 * np.cos(t), 0.1 * t], axis=1)
    stamps_ns = np.rint((50.0 + t) * 1e9).astype(np.int64)
    drive = Trajectory(stamps_ns, positions, np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1)))
    folder = tmp_path / "compared"
    folder.mkdir()
    write_tum(folder / "camera.tum", drive)
    write_tum(tmp_path / "reference.tum", drive)
    return folder


@pytest.fixture
def words_of(wheeled_folder, published, compared):
    """The words of each command, for a folder of its output; and the name of a file that it writes there."""

    def words(command, folder):
        return {
            "run": ("run", wheeled_folder, "--out", folder),
            "benchmark": ("benchmark", wheeled_folder, "--repeats", "1", "--out", folder),
            "calibrate": ("calibrate", wheeled_folder, "--out", folder / "robot.yaml"),
            "collect": ("collect", published, "--out", folder),
            "evaluate": ("evaluate", compared, "--reference", compared.parent / "reference.tum", "--out", folder),
            "simulate": (*SIMULATE, "--out", folder / "a.bag"),
        }[command]

    return lambda command, folder: [str(word) for word in words(command, folder)]


A_FILE_OF = {
    "run": "fused_smoothed.tum",
    "benchmark": "benchmark.json",
    "calibrate": "robot.yaml",
    "collect": "wheel.tum",
    "evaluate": "error.svg",
    "simulate": "a.truth.yaml",
}
COMMANDS = tuple(A_FILE_OF)


@pytest.fixture
def no_work(monkeypatch):
    """What takes time must not begin."""

    def begun(*_arguments, **_options):
        raise AssertionError("the work has begun")

    monkeypatch.setattr(warmup, "load_kernels", begun)  # run, benchmark, calibrate
    monkeypatch.setattr(bag_trajectories, "read_trajectories", begun)
    monkeypatch.setattr(trajectory, "read_tum", begun)
    monkeypatch.setattr(bag_writer, "BagWriter", begun)


def refusal(capsys, words):
    assert main(words) == 2
    captured = capsys.readouterr()
    (line,) = [line for line in captured.err.splitlines() if not line.startswith("warning: ")]
    assert line.startswith("error: ")
    assert line.endswith("; choose another --out")
    return line


@pytest.mark.parametrize("command", COMMANDS)
def test_a_folder_that_is_a_file_is_found_before_the_work(words_of, tmp_path, capsys, no_work, command):
    (tmp_path / "file").write_text("")
    assert str(tmp_path / "file") in refusal(capsys, words_of(command, tmp_path / "file"))


@pytest.mark.parametrize("command", COMMANDS)
def test_a_folder_in_the_place_of_a_file_is_found_before_the_work(words_of, out, capsys, no_work, command):
    (out / A_FILE_OF[command]).mkdir()
    line = refusal(capsys, words_of(command, out))
    assert f"{out / A_FILE_OF[command]}: cannot write the file: Is a directory" in line
    assert names(out) == {A_FILE_OF[command]}


@pytest.mark.parametrize("command", COMMANDS)
def test_a_disk_without_space_is_found_before_the_work(words_of, out, capsys, no_work, command):
    words = words_of(command, out)
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # a write beyond the limit fails as on a full disk
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, limit[1]))
    try:
        line = refusal(capsys, words)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
        signal.signal(signal.SIGXFSZ, before)
    assert f"{out}: cannot write there: File too large" in line
    assert names(out) == set()


def fill_disk_for(path):
    """The disk becomes full when this file is written."""
    path.with_name(path.name + ".part").symlink_to("/dev/full")


def failure(capsys, words, code=1):
    """The error lines of a call, and what it printed."""
    assert main(words) == code
    captured = capsys.readouterr()
    return [line for line in captured.err.splitlines() if line.startswith("error: ")], captured.out


def test_a_run_writes_all_files_but_those_that_it_cannot(words_of, out, capsys):
    fill_disk_for(out / "camera.tum")
    fill_disk_for(out / "map.ply")
    lines, printed = failure(capsys, words_of("run", out))
    assert lines == [
        f"error: {out / 'camera.tum'}: cannot write the trajectory: No space left on device",
        f"error: {out / 'map.ply'}: cannot write the point cloud: No space left on device",
    ]
    wheels = {"wheel.tum", "fused.tum", "fused_smoothed.tum", "fusion.yaml"}
    assert names(out) == (RUN_FILES | wheels) - {"camera.tum", "map.ply"}
    assert "frames tracked" in printed
    assert json.loads((out / "summary.json").read_text())["end"] == "complete"


def test_a_file_that_cannot_be_computed_does_not_stop_the_others(tum_folder, out, capsys, monkeypatch):
    def broken(_):
        raise ValueError("no such number")

    monkeypatch.setattr(visual_run.TrajectoryRecorder, "final", broken)
    lines, _ = failure(capsys, ["run", str(tum_folder), "--out", str(out)])
    assert lines == [
        f"error: {out / 'camera_final.tum'}: cannot compute what belongs there: ValueError: no such number"
    ]
    assert names(out) == RUN_FILES - {"camera_final.tum"}


def test_an_interrupted_run_says_both(tum_folder, out, capsys, monkeypatch):
    whole = visual_run.VisualRun.track
    count = [0]

    def interrupted(self, *arguments):
        count[0] += 1
        if count[0] == 30:
            raise KeyboardInterrupt
        return whole(self, *arguments)

    monkeypatch.setattr(visual_run.VisualRun, "track", interrupted)
    fill_disk_for(out / "map.ply")
    lines, _ = failure(capsys, ["run", str(tum_folder), "--out", str(out)], 130)
    assert lines == [
        f"error: {out / 'map.ply'}: cannot write the point cloud: No space left on device",
        "error: interrupted",
    ]
    assert names(out) == RUN_FILES - {"map.ply"}


def test_an_older_file_stays_where_the_new_one_cannot_be_written(words_of, out, capsys):
    assert main(words_of("collect", out)) == 0
    before = (out / "fused.tum").read_bytes()
    fill_disk_for(out / "fused.tum")
    (out / "wheel.tum").unlink()
    lines, printed = failure(capsys, words_of("collect", out))
    assert lines == [f"error: {out / 'fused.tum'}: cannot write the trajectory: No space left on device"]
    assert (out / "fused.tum").read_bytes() == before
    assert len(read_tum(out / "wheel.tum")) == 3
    assert "wheel.tum: 3 poses" in printed


def test_an_evaluation_is_printed_also_if_a_file_cannot_be_written(words_of, out, capsys):
    fill_disk_for(out / "trajectory.svg")
    fill_disk_for(out / "evaluation.json")
    lines, printed = failure(capsys, words_of("evaluate", out))
    assert [line.split(": cannot")[0] for line in lines] == [
        f"error: {out / name}" for name in ("evaluation.json", "trajectory.svg")
    ]
    assert "ATE rmse" in printed
    assert names(out) == EVALUATION_FILES - {"trajectory.svg", "evaluation.json"}


def test_a_benchmark_is_printed_also_if_it_cannot_be_written(words_of, out, capsys):
    fill_disk_for(out / "benchmark.json")
    lines, printed = failure(capsys, words_of("benchmark", out))
    assert lines == [f"error: {out / 'benchmark.json'}: cannot write the result: No space left on device"]
    assert "speed factor" in printed
    assert names(out) == set()


@pytest.mark.parametrize(("kept", "lost"), [("robot.yaml", "camera.txt"), ("camera.txt", "robot.yaml")])
def test_a_calibration_is_printed_also_if_it_cannot_be_written(words_of, out, capsys, monkeypatch, kept, lost):
    def values(names_and_units):
        return tuple(calibration.CalibratedValue(name, unit, 0.5, 0.1, 0.4, True) for name, unit in names_and_units)

    def found(_steps, robot, camera, _observe):
        of_robot = values((name, unit) for name, unit, _ in calibration.PARAMETERS)
        of_lens = values([("fx", "px"), ("k1", "")])
        return calibrating.CameraAndRobot(
            of_lens, camera, calibration.Calibration(of_robot, robot, 100, 0, ()), 2, lens_stays=False
        )

    monkeypatch.setattr(calibrating, "calibrate_all", found)
    fill_disk_for(out / lost)
    lines, printed = failure(capsys, words_of("calibrate", out))
    assert lines == [f"error: {out / lost}: cannot write the calibration: No space left on device"]
    assert names(out) == {kept}
    assert "camera yaw" in printed and "fx" in printed


def test_a_simulated_bag_stays_if_a_file_beside_it_cannot_be_written(words_of, out, capsys):
    fill_disk_for(out / "a.truth.yaml")
    lines, _ = failure(capsys, words_of("simulate", out))
    assert lines == [f"error: {out / 'a.truth.yaml'}: cannot write the file: No space left on device"]
    assert names(out) == {"a.bag", "a.groundtruth.tum", "a.groundtruth_base.tum", "a.robot.yaml"}


def test_a_full_disk_leaves_an_older_simulation_as_it_was(words_of, out, capsys):
    assert main(words_of("simulate", out)) == 0
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    restore = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, limit[1]))
    try:
        lines, _ = failure(capsys, [*words_of("simulate", out), "--seed", "5"])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
        signal.signal(signal.SIGXFSZ, restore)
    assert len(lines) == 1 and "a.bag" in lines[0]
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before


def folder_of_recording(path):
    path.mkdir()
    for name in ("camera.txt", "times.txt"):
        (path / name).write_text("kept\n")
    return path


@pytest.mark.parametrize(
    "words",
    [
        "map build drive.bag other.bag --out other.bag",
        "map build drive.bag --out link.bag",
        "map build recording --out recording/times.txt",
        "map info site.map --picture site.map.png --way site.map.png",
        "reference drive.bag --out drive.bag",
        "reference drive.tum.bag --at wanted.tum --out wanted.tum",
        "calibrate drive.bag --out drive.bag",
        "calibrate drive.bag --robot robot.yaml --out robot.yaml",
        "calibrate drive.bag --camera lens/camera.txt --out lens/robot.yaml",
        "calibrate recording --out recording/robot.yaml",
    ],
)
def test_no_command_replaces_what_it_reads(tmp_path, monkeypatch, capsys, words):
    monkeypatch.chdir(tmp_path)
    folder_of_recording(tmp_path / "recording")
    (tmp_path / "lens").mkdir()
    for name in ("drive.bag", "other.bag", "drive.tum.bag", "robot.yaml", "lens/camera.txt", "site.map.png"):
        (tmp_path / name).write_text("kept\n")
    write_tum(tmp_path / "wanted.tum", Trajectory(np.array([1]), np.zeros((1, 3)), np.array([[0.0, 0.0, 0.0, 1.0]])))
    (tmp_path / "link.bag").symlink_to("drive.bag")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert main(words.split()) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ")
    assert line.endswith("is what the command reads; choose another --out")
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize("words", [SIMULATE, ("record",)])
def test_a_recording_that_cannot_be_made_again_is_not_replaced(tmp_path, capsys, words):
    path = tmp_path / "drive.bag"
    path.write_text("recorded")
    assert main([*words, "--out", str(path)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "drive.bag: exists already" in line
    assert path.read_text() == "recorded"


@pytest.mark.parametrize(
    "words",
    [
        ("sweep", "{name}", "--out", "{folder}/study"),
        ("sweep", "{folder}", "--out", "{name}"),
        ("reference", "{name}", "--out", "{folder}/reference.tum"),
        ("reference", "{folder}/drive.bag", "--out", "{name}.tum"),
    ],
)
def test_names_that_cannot_be_written_to_a_text_are_said_before_the_work(tmp_path, capsys, words):
    name = os.fsdecode(b"caf\xe9")
    assert main([word.format(name=tmp_path / name, folder=tmp_path) for word in words]) == 2
    told = capsys.readouterr().err
    assert "the name is not UTF-8" in told
    assert told.count("\n") == 1
    assert not list(tmp_path.iterdir())
