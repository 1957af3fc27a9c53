# SPDX-License-Identifier: BSD-3-Clause
import os
from pathlib import Path

import numpy as np
import pytest

from ceiling_dso_ros.cli.main import main
from ceiling_dso_ros.io.camera_models import read_camera_file
from ceiling_dso_ros.io.robot_file import read_robot_file

DATA = Path(os.environ.get("CEILING_DSO_DATA", Path(__file__).parents[2].parent / "shared" / "data"))
ROBOT = """ticks_per_turn: 4096
wheel_radius: [0.098, 0.098]
wheel_base: 0.485
T_base_camera: {xyz: [0.18, 0.04, 0.62], quat_xyzw: [0, 0, 0, 1]}
"""


@pytest.fixture
def recording(tum_folder):
    """The small recording with wheels that stand still."""
    stamps = [line.split()[1] for line in (tum_folder / "times.txt").read_text().splitlines()]
    (tum_folder / "encoders.csv").write_text("stamp,left,right\n" + "".join(f"{stamp},7,7\n" for stamp in stamps))
    (tum_folder / "robot.yaml").write_text(ROBOT)
    return tum_folder


def refusal(capsys, *words):
    """The one line that a wrong call gives."""
    assert main(["calibrate", *map(str, words)]) == 2
    captured = capsys.readouterr().err.splitlines()
    assert len([line for line in captured if line.startswith("error: ")]) == 1
    return captured[-1]


def test_a_recording_without_wheels_is_refused(tum_folder, tmp_path, capsys):
    assert "has no wheels" in refusal(capsys, tum_folder, "--out", tmp_path / "robot.yaml")


def test_unknown_dimensions_are_asked_for(recording, tmp_path, capsys):
    (recording / "robot.yaml").unlink()
    assert "--robot" in refusal(capsys, recording, "--out", tmp_path / "robot.yaml")


def test_a_camera_that_looks_down_is_refused(recording, tmp_path, capsys):
    (recording / "robot.yaml").write_text(ROBOT.replace("[0, 0, 0, 1]", "[1, 0, 0, 0]"))
    assert "must look up" in refusal(capsys, recording, "--out", tmp_path / "robot.yaml")


def test_a_robot_that_stood_is_refused_and_nothing_is_written(recording, tmp_path, capsys):
    assert "drive for longer" in refusal(capsys, recording, "--out", tmp_path / "robot.yaml")
    assert not (tmp_path / "robot.yaml").exists()


def test_the_calibration_of_the_recording_is_not_replaced(recording, capsys):
    before = (recording / "camera.txt").read_text()
    assert "camera.txt: is what the command reads; choose another --out" in refusal(
        capsys, recording, "--out", recording / "found.yaml"
    )
    assert "drive for longer" in refusal(capsys, recording, "--out", recording / "found.yaml", "--keep-lens")
    assert (recording / "camera.txt").read_text() == before


def calibrated(tmp_path, capsys, *words):
    """What is printed of the shared recording; the files are in tmp_path."""
    folder = DATA / "ceiling_loops"
    if not folder.is_dir():
        pytest.skip(f"the recording is missing: {folder}")
    assert main(["calibrate", str(folder), "--out", str(tmp_path / "robot.yaml"), *words]) == 0
    return capsys.readouterr().out


def assert_its_mount(tmp_path):
    true, found = read_robot_file(DATA / "ceiling_loops" / "robot.yaml"), read_robot_file(tmp_path / "robot.yaml")
    difference = np.linalg.inv(true.T_base_camera) @ found.T_base_camera
    assert np.degrees(np.arccos((np.trace(difference[:3, :3]) - 1.0) / 2.0)) < 0.3
    np.testing.assert_allclose(found.T_base_camera[:3, 3], true.T_base_camera[:3, 3], atol=0.015)
    assert found.wheel_base_m == pytest.approx(true.wheel_base_m, rel=0.02)


@pytest.mark.long
def test_the_shared_recording_confirms_its_lens_and_robot(tmp_path, capsys):
    table = calibrated(tmp_path, capsys)
    assert "cannot be estimated" in table
    assert "fits the images, and stays as it is" in table
    told, kept = (read_camera_file(path / "camera.txt").lens for path in (DATA / "ceiling_loops", tmp_path))
    assert (kept.fx, kept.fy, kept.cx, kept.cy) == (told.fx, told.fy, told.cx, told.cy)
    assert not any(kept.distortion)
    assert_its_mount(tmp_path)
    assert (tmp_path / "robot.yaml").read_text().startswith("# calibrated from ceiling_loops")


@pytest.mark.long
def test_a_wrong_lens_is_found_together_with_the_mount(tmp_path, capsys):
    told = read_camera_file(DATA / "ceiling_loops" / "camera.txt").lens
    wrong = tmp_path / "wrong.txt"
    wrong.write_text(f"RadTan {told.fx} {told.fy} {told.cx + 3} {told.cy + 2} 0.01 0 0 0\n848 480\ncrop\n848 480\n")
    table = calibrated(tmp_path, capsys, "--camera", str(wrong))
    assert "hardly told by the motion" in table  # the focal length of a camera that moves in a plane
    assert "stays as it is" not in table
    corrected = read_camera_file(tmp_path / "camera.txt").lens
    assert corrected.cx == pytest.approx(told.cx, abs=1.5)
    assert corrected.cy == pytest.approx(told.cy, abs=1.0)
    np.testing.assert_allclose(corrected.distortion, [0.0] * 4, atol=0.004)
    assert_its_mount(tmp_path)
