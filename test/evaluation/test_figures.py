# SPDX-License-Identifier: BSD-3-Clause
import struct

import numpy as np
import pytest

from ceiling_dso_ros.evaluation.alignment import AlignmentKind
from ceiling_dso_ros.evaluation.figures import FILES, figure_writers
from ceiling_dso_ros.evaluation.report import evaluate_trajectory
from ceiling_dso_ros.io.replacing import write_each
from ceiling_dso_ros.io.trajectory import Trajectory


def drive(noise_m=0.0):
    stamps_s = np.arange(0.0, 10.0, 0.1)
    positions = np.stack([3.0 * np.sin(stamps_s), 2.0 * np.cos(stamps_s), 0.1 * stamps_s], axis=1)
    positions += np.random.default_rng(0).normal(scale=noise_m, size=positions.shape)
    return Trajectory(
        np.rint(stamps_s * 1e9).astype(np.int64), positions, np.tile([0.0, 0.0, 0.0, 1.0], (len(stamps_s), 1))
    )


def draw(directory, noise_m=0.02):
    directory.mkdir(exist_ok=True)
    evaluations = [
        evaluate_trajectory(name, drive(noise_m), drive(), kind, 0.01)
        for name, kind in (("camera_final", AlignmentKind.SIM3), ("wheel", AlignmentKind.SE2))
    ]
    write_each(directory, figure_writers([drive().positions], evaluations))
    return {name: (directory / name).read_bytes() for name in FILES}


def test_writes_readable_images_with_names_and_units(tmp_path):
    files = draw(tmp_path)
    for name in ("trajectory.png", "error.png"):
        assert files[name].startswith(b"\x89PNG")
        width, height = struct.unpack(">II", files[name][16:24])
        assert width > height > 300
    for text in (b"x [m]", b"y [m]", b"reference", b"camera_final", b"wheel"):
        assert text in files["trajectory.svg"]
    for text in (b"distance travelled [m]", b"position error [mm]", b"RMSE"):
        assert text in files["error.svg"]


def test_large_errors_are_in_metres(tmp_path):
    assert b"position error [m]" in draw(tmp_path, noise_m=0.5)["error.svg"]


@pytest.mark.long
def test_the_same_numbers_give_the_same_bytes(tmp_path):
    first = draw(tmp_path / "first")
    second = draw(tmp_path / "second")
    other = draw(tmp_path / "other", noise_m=0.03)
    for name in FILES:
        assert first[name] == second[name], name
        assert first[name] != other[name], name


@pytest.mark.parametrize("name", ["trajectory.png", "trajectory.svg"])
def test_carries_no_date(tmp_path, name):
    assert b"date" not in draw(tmp_path)[name].lower()
