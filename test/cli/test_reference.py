# SPDX-License-Identifier: BSD-3-Clause
import gzip
import json

import numpy as np
import pytest

from ceiling_dso_ros.cli.main import main
from ceiling_dso_ros.io.bag_writer import BagWriter
from ceiling_dso_ros.io.pose_covariances import read_covariances
from ceiling_dso_ros.io.trajectory import read_tum, write_tum
from ceiling_dso_ros.simulation.bag import MeasurementMessages, write_files_beside
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.recording import SimulatedRecording
from ceiling_dso_ros.simulation.sensors.laser import LaserModel

SECONDS = 8.0


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """Scans and wheels of a drive, without its images."""
    path = tmp_path_factory.mktemp("bag") / "drive.bag"
    laser = LaserModel(rays=361, range_noise_m=0.02)
    recording = SimulatedRecording(SimulationConfig("square", duration_s=SECONDS, laser=laser))
    simulation = recording.simulation
    with BagWriter(path) as writer:
        messages = MeasurementMessages(writer, simulation)
        measured = [*simulation.wheel_readings(), *simulation.scans()]
        for measurement in sorted(measured, key=lambda each: each.stamp_ns):
            messages.write(measurement)
    write_files_beside(path, recording)
    return path


@pytest.fixture(scope="module")
def reference(bag):
    out = bag.with_name("reference.tum")
    assert main(["reference", str(bag), "--out", str(out)]) == 0
    return out


@pytest.mark.long
def test_all_files_are_written(bag, reference, capsys):
    poses, covariances = read_tum(reference), read_covariances(reference.with_name("reference.covariance.txt"))
    assert poses.stamps_ns.tolist() == covariances.stamps_ns.tolist()
    assert len(poses) > 70
    report = json.loads(reference.with_name("reference.report.json").read_text())
    assert report["scans"] == len(poses)
    assert report["sigma"]["position_rms_m"] < 0.01
    pgm = reference.with_name("reference.map.pgm").read_bytes()
    assert pgm.startswith(b"P5\n")
    columns, rows = map(int, pgm.split(b"\n", 3)[1].split())
    assert (columns > 15 / 0.05 and rows > 10 / 0.05) or rows > 15 / 0.05
    yaml = reference.with_name("reference.map.yaml").read_text()
    assert "image: reference.map.pgm" in yaml and "resolution: 0.05" in yaml
    for name in ("reference.map.png", "reference.trajectory.png"):
        assert reference.with_name(name).read_bytes().startswith(b"\x89PNG")


@pytest.mark.long
def test_it_can_be_asked_for_other_stamps_and_drawn_upon_no_wheels(bag, reference, tmp_path, capsys):
    truth = read_tum(bag.with_name("drive.groundtruth_base.tum"))
    out = tmp_path / "dense.tum"
    words = ["--at", str(bag.with_name("drive.groundtruth_base.tum")), "--no-self-check"]
    assert main(["reference", str(bag), "--out", str(out), *words]) == 0
    assert read_tum(out).stamps_ns.tolist() == truth.stamps_ns.tolist()
    assert main(["reference", str(bag), "--out", str(tmp_path / "alone.tum"), "--no-wheels", "--no-self-check"]) == 0
    assert "standard deviation of the position" in capsys.readouterr().out


@pytest.mark.long
def test_evaluate_prints_how_sure_it_is(bag, reference, tmp_path, capsys):
    run = tmp_path / "run"
    run.mkdir()
    truth = read_tum(bag.with_name("drive.groundtruth_base.tum"))
    write_tum(run / "wheel.tum", truth)
    noisy = truth.positions + 0.002 * np.random.default_rng(0).standard_normal(truth.positions.shape)
    write_tum(run / "fused.tum", type(truth)(truth.stamps_ns, noisy, truth.quaternions_xyzw))
    words = ["evaluate", str(run), "--reference", str(reference), "--interpolate"]
    assert main([*words, "--reference-sigma"]) == 0
    said = capsys.readouterr().out
    assert "the reference's own uncertainty" in said
    numbers = json.loads((run / "evaluation.json").read_text())
    assert numbers["reference_sigma"]["wheel"]["position_m"] < 0.01
    assert main([*words, "--reference-sigma", "0.5"]) == 0
    said = capsys.readouterr().out
    assert "wheel = fused (=: the reference does not tell them apart)" in said
    assert "* " in said
    assert main(words) == 0
    assert "uncertainty" not in capsys.readouterr().out


def test_wrong_words_are_one_line(bag, tmp_path, capsys):
    out = str(tmp_path / "r.tum")
    cases = {
        (str(tmp_path / "missing.bag"),): "there is no such bag",
        (str(bag), "--scan-topic", "/other"): "no scans on /other; its topics with scans: /scan",
        (str(bag), "--laser-frame", "nose"): "tf has no base_link -> nose",
        (str(bag), "--laser-mount", "0", "0", "nan"): "must be finite",
        (str(bag), "--at", str(tmp_path / "missing.tum")): "cannot read the file",
    }
    for words, expected in cases.items():
        assert main(["reference", *words, "--out", out]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert expected in line


def test_a_bag_without_scans_is_one_line(tmp_path, capsys):
    path = tmp_path / "empty.bag"
    with BagWriter(path) as writer:
        writer.ticks("/wheel/left/ticks", 10**18, 1)
    assert main(["reference", str(path), "--out", str(tmp_path / "r.tum")]) == 2
    assert "has no scans; record sensor_msgs/LaserScan" in capsys.readouterr().err


def test_wrong_sigmas_are_one_line(tmp_path, capsys):
    write_tum(tmp_path / "fused.tum", read_tum_of_three())
    write_tum(tmp_path / "gt.tum", read_tum_of_three())
    words = ["evaluate", str(tmp_path), "--reference", str(tmp_path / "gt.tum"), "--reference-sigma"]
    for value, expected in (
        ([], "gt.covariance.txt: there is no such file"),
        (["-1"], "must be a positive number of metres"),
        (["nan"], "must be a positive number of metres"),
        ([str(tmp_path / "nothing.txt")], "cannot read the file"),
    ):
        assert main([*words, *value]) == 2
        assert expected in capsys.readouterr().err


def read_tum_of_three():
    from ceiling_dso_ros.io.trajectory import Trajectory

    T = np.tile(np.eye(4), (3, 1, 1))
    T[:, 0, 3] = 0.0, 1.0, 2.0
    T[:, 1, 3] = 0.0, 0.5, 0.0
    return Trajectory.from_matrices([10**9, 2 * 10**9, 3 * 10**9], T)


@pytest.mark.long
def test_a_log_of_carmen_is_read(tmp_path, capsys):
    """A square room, 5 x 4 m, seen from a robot that goes along it."""
    angles = np.radians(np.arange(-90.0, 90.0))
    lines = []
    for number in range(12):
        x, y = -1.5 + 0.1 * number, 0.2
        with np.errstate(divide="ignore"):
            c, s = np.cos(angles), np.sin(angles)
            reach = np.minimum((2.5 - x) / np.maximum(c, 1e-9), np.where(s > 0, (2.0 - y) / s, (-2.0 - y) / s))
        ranges = " ".join(f"{r:.2f}" for r in reach)
        lines.append(f"FLASER 180 {ranges} {x} {y} 0 {x} {y} 0 {number} host {number}\n")
    path = tmp_path / "room.log.gz"
    path.write_bytes(gzip.compress("".join(lines).encode()))
    assert main(["reference", str(path), "--out", str(tmp_path / "r.tum"), "--no-wheels"]) == 0
    found = read_tum(tmp_path / "r.tum")
    assert np.hypot(*(found.positions[-1] - found.positions[0])[:2]) == pytest.approx(1.1, abs=0.03)
