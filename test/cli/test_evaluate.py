# SPDX-License-Identifier: BSD-3-Clause
import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from ceiling_dso_ros.cli.main import main
from ceiling_dso_ros.io.trajectory import Trajectory, write_tum

ROOT = Path(__file__).parents[2]
DATA = Path(os.environ.get("CEILING_DSO_DATA", ROOT.parent / "shared" / "data"))


def drive(scale=1.0, shift_s=0.0):
    t = np.arange(0.0, 10.0, 0.1)
    stamps_ns = np.rint((50.0 + shift_s + t) * 1e9).astype(np.int64)
    positions = scale * np.stack([3.0 * np.sin(t), 2.0 * np.cos(t), 0.1 * t], axis=1)
    return Trajectory(stamps_ns, positions, np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1)))


@pytest.fixture
def run_folder(tmp_path):
    """A folder as `run` leaves it, beside its reference."""
    folder = tmp_path / "run"
    folder.mkdir()
    write_tum(tmp_path / "reference.tum", drive())
    write_tum(folder / "camera.tum", drive(scale=0.4))
    write_tum(folder / "camera_final.tum", drive(scale=0.5))
    return folder


@pytest.fixture
def evaluate(command):
    def run(folder, *arguments, reference=None):
        return command("evaluate", folder, "--reference", reference or folder.parent / "reference.tum", *arguments)

    return run


def assert_refused(result, *texts):
    assert result.returncode == 2, result
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1
    for text in texts:
        assert text in result.stderr


def test_writes_numbers_and_figures_and_prints_a_table(run_folder, evaluate):
    result = evaluate(run_folder)
    assert (result.returncode, result.stderr) == (0, "")
    assert {"trajectory.png", "trajectory.svg", "error.png", "error.svg", "evaluation.json"} <= {
        path.name for path in run_folder.iterdir()
    }
    numbers = json.loads((run_folder / "evaluation.json").read_text())
    assert list(numbers["trajectories"]) == ["camera", "camera_final"]
    assert numbers["trajectories"]["camera"]["scale"] == pytest.approx(2.5)
    assert numbers["trajectories"]["camera_final"]["ate_m"]["rmse"] < 1e-6
    assert "camera_final" in result.stdout
    assert "ATE" in result.stdout


def test_each_trajectory_is_aligned_as_it_deserves_unless_told_otherwise(run_folder):
    for name in ("fused", "mapped"):
        write_tum(run_folder / f"{name}.tum", drive())
    reference = str(run_folder.parent / "reference.tum")

    def alignments(*arguments):
        assert main(["evaluate", str(run_folder), "--reference", reference, *arguments]) == 0
        trajectories = json.loads((run_folder / "evaluation.json").read_text())["trajectories"]
        return {name: numbers["alignment"] for name, numbers in trajectories.items()}

    assert alignments() == {"camera": "sim3", "camera_final": "sim3", "fused": "se2", "mapped": "se2"}
    assert set(alignments("--align", "se3").values()) == {"se3"}


def moved(trajectory, shift_m):
    return Trajectory(trajectory.stamps_ns, trajectory.positions + shift_m, trajectory.quaternions_xyzw)


@pytest.mark.parametrize("how", ["given", "beside the camera's", "one for all"])
def test_what_moves_with_the_base_has_a_reference_of_its_own(run_folder, how, capsys):
    """The base turns about another point than the camera: no alignment makes one path of the other."""
    camera_m, base_m = drive().positions, drive().positions * [1.0, 0.5, 0.0]
    write_tum(run_folder / "fused.tum", moved(drive(), base_m - camera_m))
    folder, words = run_folder.parent, []
    if how != "one for all":
        base = folder / ("base.tum" if how == "given" else "reference_base.tum")
        write_tum(base, moved(drive(), base_m - camera_m))
        words = ["--base-reference", str(base)] if how == "given" else []
    assert main(["evaluate", str(run_folder), "--reference", str(folder / "reference.tum"), *words]) == 0
    evaluation = json.loads((run_folder / "evaluation.json").read_text())
    rmse_m = {name: numbers["ate_m"]["rmse"] for name, numbers in evaluation["trajectories"].items()}
    assert rmse_m["camera"] < 1e-6
    assert (rmse_m["fused"] < 1e-6) == (how != "one for all")
    against = folder / "reference.tum" if how == "one for all" else base
    assert evaluation["base_reference"] == str(against)
    assert f"fused: against {against}" in capsys.readouterr().out


def turned(trajectory, quaternion_xyzw):
    turn = np.tile(quaternion_xyzw, (len(trajectory), 1))
    return Trajectory(trajectory.stamps_ns, trajectory.positions, turn)


def test_a_reference_of_another_body_is_said(run_folder, capsys):
    """The camera's reference alone: what moves with the base is compared with it, but not without a word."""
    write_tum(run_folder / "fused.tum", turned(drive(), [0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)]))
    assert main(["evaluate", str(run_folder), "--reference", str(run_folder.parent / "reference.tum")]) == 0
    (line,) = capsys.readouterr().err.splitlines()
    assert "reference.tum: is of another body than fused (90 degrees)" in line
    assert "give --base-reference a trajectory of base_link" in line
    evaluation = json.loads((run_folder / "evaluation.json").read_text())
    assert evaluation["trajectories"]["fused"]["body_rotation_deg"] == pytest.approx(90.0, abs=0.1)
    assert line.endswith(evaluation["warnings"][0])


def test_files_are_written_before_a_reader_that_leaves(run_folder):
    """As in `evaluate ... | head -1`."""
    reading, writing = os.pipe()
    os.close(reading)
    words = ["evaluate", str(run_folder), "--reference", str(run_folder.parent / "reference.tum")]
    process = subprocess.run(
        [sys.executable, "-m", "ceiling_dso_ros", *words],
        env={**os.environ, "PYTHONPATH": str(ROOT / "src")},
        stdout=writing,
        stderr=subprocess.PIPE,
    )
    os.close(writing)
    assert (process.returncode, process.stderr) == (0, b"")
    assert {"evaluation.json", "trajectory.png", "error.svg"} <= {path.name for path in run_folder.iterdir()}


def test_missing_base_reference(run_folder, evaluate):
    assert_refused(evaluate(run_folder, "--base-reference", run_folder / "gt.tum"), "gt.tum", "No such file")


def test_interpolates_the_reference_when_asked_to(run_folder):
    between = drive()
    middle_ns = between.stamps_ns[:-1] + 50_000_000
    positions = (between.positions[:-1] + between.positions[1:]) / 2
    write_tum(run_folder / "camera.tum", Trajectory(middle_ns, positions, between.quaternions_xyzw[:-1]))
    reference = str(run_folder.parent / "reference.tum")

    def rmse(*arguments):
        words = ["evaluate", str(run_folder), "--reference", reference, "--align", "se3", "--max-difference", "0.06"]
        assert main([*words, *arguments]) == 0
        evaluation = json.loads((run_folder / "evaluation.json").read_text())
        return evaluation["interpolated"], evaluation["trajectories"]["camera"]["ate_m"]["rmse"]

    assert rmse("--interpolate") == (True, pytest.approx(0.0, abs=1e-7))
    assert rmse()[0] is False
    assert rmse()[1] > 1e-3


def test_running_twice_gives_the_same_bytes(run_folder, evaluate):
    assert evaluate(run_folder).returncode == 0
    first = {path.name: path.read_bytes() for path in run_folder.iterdir()}
    assert evaluate(run_folder).returncode == 0
    assert {path.name: path.read_bytes() for path in run_folder.iterdir()} == first


def test_missing_reference(run_folder, evaluate):
    assert_refused(evaluate(run_folder, reference=run_folder / "gt.tum"), "gt.tum", "No such file")


def test_missing_folder(run_folder, evaluate):
    assert_refused(evaluate(run_folder / "nowhere", reference=run_folder.parent / "reference.tum"), "nowhere")


def test_folder_without_trajectories(run_folder, evaluate):
    for path in run_folder.iterdir():
        path.unlink()
    assert_refused(evaluate(run_folder), str(run_folder), "camera.tum")


def without_poses(path):
    path.write_text("")


def with_broken_lines_only(path):
    path.write_text("100.0 1 2 3\n" * 5)


def of_another_time(path):
    write_tum(path, drive(shift_s=1000.0))


def of_two_poses(path):
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:2]))


@pytest.mark.parametrize(
    ("spoil", "complaint"),
    [
        (without_poses, ": no poses in it"),
        (with_broken_lines_only, ", line 1: 4 numbers instead of 8"),
        (of_another_time, "no overlap in time: it covers 1050.000 to 1059.900 s, the reference 50.000 to 59.900 s"),
        (of_two_poses, "2 pairs of poses, at least 3 are needed"),
    ],
)
def test_a_trajectory_that_cannot_be_compared_is_left_out_and_said(run_folder, capsys, spoil, complaint):
    words = ["evaluate", str(run_folder), "--reference", str(run_folder.parent / "reference.tum")]
    spoil(run_folder / "camera.tum")
    assert main(words) == 0
    said = capsys.readouterr().err
    assert said.startswith(f"warning: {run_folder / 'camera.tum'}")
    assert said.endswith("; left out\n")
    assert complaint in said
    assert said.count("\n") == 1
    numbers = json.loads((run_folder / "evaluation.json").read_text())
    assert list(numbers["trajectories"]) == ["camera_final"]
    assert complaint in numbers["left_out"]["camera"]
    (run_folder / "camera_final.tum").unlink()
    assert main(words) == 2
    assert complaint in capsys.readouterr().err


def test_poses_without_a_partner_in_the_reference_are_said(run_folder, capsys):
    reference = run_folder.parent / "reference.tum"
    reference.write_text("".join(reference.read_text().splitlines(keepends=True)[:60]))
    assert main(["evaluate", str(run_folder), "--reference", str(reference)]) == 0
    assert "camera: 40 of 100 poses are not compared: 40 after it ends\n" in capsys.readouterr().out
    numbers = json.loads((run_folder / "evaluation.json").read_text())["trajectories"]["camera"]
    assert (numbers["poses"], numbers["pairs"], numbers["late"]) == (100, 60, 40)


def test_times_of_the_reference_without_poses_are_said(run_folder, capsys):
    camera = run_folder / "camera.tum"
    lines = camera.read_text().splitlines(keepends=True)
    camera.write_text("".join(lines[20:50] + lines[70:]))
    assert main(["evaluate", str(run_folder), "--reference", str(run_folder.parent / "reference.tum")]) == 0
    said = "camera: no poses for 4.1 of 9.9 s of the reference: 2.0 s at its beginning, 2.1 s in 1 gap\n"
    assert said in capsys.readouterr().out


def spoil_lines(path):
    """As files are that were written by a killed process, merged, or filled by a motion capture that saw nothing."""
    lines = path.read_text().splitlines(keepends=True)
    lost = " ".join([lines[40].split()[0], *["nan"] * 7]) + "\n"
    far_too_late = " ".join(["99999.0", *lines[10].split()[1:]]) + "\n"
    path.write_text(
        "".join([*lines[:40], lost, lost, *lines[42:50], lines[49], far_too_late, *lines[50:], lines[3][:30]])
    )


@pytest.mark.parametrize("spoilt", ["run/camera.tum", "reference.tum"])
def test_lines_that_cannot_be_used_are_left_out_and_said(run_folder, capsys, spoilt):
    path = run_folder.parent / spoilt
    spoil_lines(path)
    assert main(["evaluate", str(run_folder), "--reference", str(run_folder.parent / "reference.tum")]) == 0
    said = capsys.readouterr().err.splitlines()
    assert said == [
        f"warning: {path}, line 41: a number is not finite; left out, as are 1 more such lines",
        f"warning: {path}, line 103: 3 numbers instead of 8: stamp tx ty tz qx qy qz qw; left out",
        f"warning: {path}, line 51: the stamp is that of another line; left out",
        f"warning: {path}, line 52: the stamp is out of order; left out",
    ]
    evaluation = json.loads((run_folder / "evaluation.json").read_text())
    assert [f"warning: {text}" for text in evaluation["warnings"]] == said
    assert evaluation["trajectories"]["camera"]["pairs"] == 98
    assert evaluation["trajectories"]["camera"]["ate_m"]["rmse"] < 1e-6


def winding(late_s=0.0, rate_hz=20.0):
    """A drive of a minute whose speed and yaw rate change all the time."""
    t = np.arange(0.0, 60.0, 1.0 / rate_hz)
    stamps_ns = np.rint((1_732_800_000 + late_s + t) * 1e9).astype(np.int64)
    yaw = np.sin(0.9 * t) + np.cos(0.4 * t)
    positions = np.stack([3.0 * np.sin(0.5 * t), 2.0 * np.cos(0.8 * t), 0.0 * t], axis=1)
    quaternions = np.stack([0.0 * t, 0.0 * t, np.sin(yaw / 2), np.cos(yaw / 2)], axis=1)
    return Trajectory(stamps_ns, positions, quaternions)


def test_a_reference_that_is_stamped_late_is_said_and_can_be_corrected(run_folder, capsys):
    reference = run_folder.parent / "reference.tum"
    for path in run_folder.iterdir():
        path.unlink()
    write_tum(run_folder / "camera.tum", winding())
    write_tum(reference, winding(0.05, 100.0))
    words = ["evaluate", str(run_folder), "--reference", str(reference)]

    def evaluation(*more):
        assert main([*words, *more]) == 0
        numbers = json.loads((run_folder / "evaluation.json").read_text())
        return numbers, numbers["trajectories"]["camera"]["ate_m"]["rmse"], capsys.readouterr()

    numbers, rmse_m, said = evaluation()
    assert numbers["time_offset_s"] == 0.0
    assert numbers["time_offsets"]["camera"]["value_s"] == pytest.approx(0.05, abs=0.001)
    assert rmse_m > 0.02
    assert said.err.startswith(f"warning: {reference}: is stamped later than camera (+50.0 +- ")
    assert said.err.endswith("; nothing is corrected without --time-offset 0.050\n")
    assert "camera: time offset of the reference +50.0 +- " in said.out
    numbers, rmse_m, said = evaluation("--time-offset", "0.05")
    assert (numbers["time_offset_s"], said.err) == (0.05, "")
    assert numbers["time_offsets"]["camera"]["value_s"] == pytest.approx(0.0, abs=0.001)
    assert rmse_m < 1e-6
    _, rmse_m, said = evaluation("--time-offset", "-0.05")
    assert rmse_m > 0.05
    assert f"{reference}: is stamped later than camera (+100.0 +- " in said.err
    assert said.err.endswith("; give --time-offset 0.050 instead\n")


def test_a_late_reference_without_any_pair_is_said(run_folder, evaluate):
    """Between the stamps of a reference with few poses a second, an offset leaves no pair at all."""
    reference = run_folder.parent / "reference.tum"
    t = np.arange(0.0, 30.0, 0.1)
    phase = t + 0.5 * np.sin(2.0 * t)  # of changing speed
    positions = np.stack([3.0 * np.sin(phase), 2.0 * np.cos(phase), 0.1 * t], axis=1)
    truth = Trajectory(
        np.rint(1e9 * (50.0 + t)).astype(np.int64), positions, np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1))
    )
    write_tum(reference, truth.shifted(50_000_000))
    for name in ("camera", "camera_final"):
        write_tum(run_folder / f"{name}.tum", truth)
    assert_refused(
        evaluate(run_folder), "raise --max-difference, or give --time-offset 0.050: the reference is stamped later"
    )
    assert evaluate(run_folder, "--time-offset", "0.05").returncode == 0
    write_tum(reference, truth.shifted(3_000_000_000_000))
    assert "--time-offset" not in evaluate(run_folder).stderr


def test_a_clock_that_began_with_zero_can_be_corrected_exactly(run_folder):
    drive_ns = drive().stamps_ns
    for name in ("camera", "camera_final"):
        write_tum(run_folder / f"{name}.tum", drive().shifted(1_732_800_000_123_456_789))
    words = ["evaluate", str(run_folder), "--reference", str(run_folder.parent / "reference.tum")]
    assert main(words) == 2
    assert main([*words, "--max-difference", "1e-9", "--time-offset", "-1732800000.123456789"]) == 0
    assert json.loads((run_folder / "evaluation.json").read_text())["trajectories"]["camera"]["pairs"] == len(drive_ns)


@pytest.mark.parametrize("value", ["soon", "nan", "inf", "1e30"])
def test_wrong_time_offset(run_folder, value, evaluate):
    assert_refused(evaluate(run_folder, f"--time-offset={value}"), "--time-offset", value)


@pytest.mark.parametrize("value", ["0", "-1", "nan", "soon"])
def test_wrong_max_difference(run_folder, value, evaluate):
    assert_refused(evaluate(run_folder, f"--max-difference={value}"), "--max-difference", value)


def test_wrong_alignment(run_folder, evaluate):
    assert_refused(evaluate(run_folder, "--align", "best"), "--align", "best")


def test_unwritable_folder(run_folder, evaluate):
    (run_folder / "evaluation.json").mkdir()
    assert_refused(evaluate(run_folder), str(run_folder), "Is a directory")


@pytest.mark.parametrize("recording", ["tum_fr1_xyz", "ceiling_loops"])
def test_ate_of_real_trajectories_agrees_with_evo_ape(tmp_path, recording):
    estimate, reference = DATA / recording / "reference_final.tum", DATA / recording / "groundtruth.tum"
    if not estimate.exists():
        pytest.skip(f"{estimate} is missing: set CEILING_DSO_DATA to the folder of the recordings")
    (tmp_path / "camera_final.tum").write_text(estimate.read_text())
    assert main(["evaluate", str(tmp_path), "--reference", str(reference)]) == 0
    ate_m = json.loads((tmp_path / "evaluation.json").read_text())["trajectories"]["camera_final"]["ate_m"]
    evo_m = evo_ape_statistics(reference, estimate, tmp_path)
    for name in ("rmse", "mean", "median", "max"):
        assert ate_m[name] == pytest.approx(evo_m[name], abs=1e-6)


def evo_ape_statistics(reference, estimate, folder):
    """What the command `evo_ape tum REFERENCE ESTIMATE -as` computes."""
    saved = folder / "evo.zip"
    words = ["tum", str(reference), str(estimate), "-as", "--save_results", str(saved)]
    start = "from evo.entry_points import ape; ape()"
    subprocess.run([sys.executable, "-c", start, *words], check=True, capture_output=True)
    with zipfile.ZipFile(saved) as archive:
        return json.loads(archive.read("stats.json"))
