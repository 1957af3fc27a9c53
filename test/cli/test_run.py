# SPDX-License-Identifier: BSD-3-Clause
import csv
import json

import cv2
import numpy as np
import pytest

from ceiling_dso_ros.fusion.config import FusionConfig
from ceiling_dso_ros.io.stamps import format_stamp
from ceiling_dso_ros.io.trajectory import read_tum
from ceiling_dso_ros.settings import load_settings

pytestmark = pytest.mark.long  # each command is a process of its own, which loads all kernels
FRAMES = 40
TRAJECTORIES = ("camera.tum", "camera_final.tum", "keyframes.tum")
FUSED = {"wheel.tum", "fused.tum", "fused_smoothed.tum", "fusion.yaml"}
OUTPUTS = {*TRAJECTORIES, "map.ply", "timing.csv", "config.yaml", "summary.json"}
IMAGE = "/camera/up/image_raw"


def summary_of(folder):
    return json.loads((folder / "summary.json").read_text())


def edit(path, line, text):
    """Replace one line, counted from 1."""
    lines = path.read_text().splitlines()
    lines[line - 1] = text
    path.write_text("\n".join(lines) + "\n")


def assert_refused(result, *texts):
    assert result.returncode == 2, result
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1
    for text in texts:
        assert text in result.stderr


def test_writes_all_files_and_they_agree(tum_folder, command, tmp_path):
    out = tmp_path / "made" / "for" / "me"
    result = command("run", tum_folder, "--out", out)
    assert (result.returncode, result.stderr) == (0, "")
    assert {path.name for path in out.iterdir()} == OUTPUTS

    summary = summary_of(out)
    assert set(summary) >= {"frames", "tracked", "lost", "keyframes", "segments", "ms", "scale", "warnings"}
    assert summary["frames"] == FRAMES
    assert summary["tracked"] > FRAMES / 2
    assert summary["end"] == "complete"
    assert summary["warnings"] == []
    assert summary["ms"]["all"]["max"] >= summary["ms"]["others"]["median"] > 0
    assert summary["scale"] == {"value": None, "sigma": None, "converged": False}
    assert f"{summary['tracked']} of {FRAMES} frames tracked" in result.stdout

    with (out / "timing.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == FRAMES
    assert {"stamp", "total_ms", "undistort_ms", "is_keyframe", "state"} <= set(rows[0])
    tracked = [row["stamp"] for row in rows if row["state"] == "tracking"]
    for name in ("camera.tum", "camera_final.tum"):
        assert [format_stamp(stamp_ns) for stamp_ns in read_tum(out / name).stamps_ns] == tracked
    assert len(read_tum(out / "keyframes.tum")) == summary["keyframes"]
    for row in rows:
        stages_ms = [float(value) for name, value in row.items() if name.endswith("_ms") and name != "total_ms"]
        assert float(row["total_ms"]) >= sum(stages_ms) * 0.5


def test_running_twice_and_from_a_bag_gives_the_same_bytes(tum_folder, bag_of, command, tmp_path):
    outputs = []
    for number, recording in enumerate((tum_folder, tum_folder, bag_of(tum_folder))):
        out = tmp_path / f"run{number}"
        assert command("run", recording, "--out", out).returncode == 0
        outputs.append([(out / name).read_bytes() for name in (*TRAJECTORIES, "map.ply", "config.yaml")])
    assert len(outputs[0][0]) > 0
    assert outputs[0] == outputs[1] == outputs[2]


def test_with_wheels_it_fuses_and_twice_gives_the_same_bytes(wheeled_folder, command, tmp_path):
    """Panels 3 m above move 0.8 pixels an image, which are 20 mm; the beams are half as far."""
    outputs = []
    for out in (tmp_path / "first", tmp_path / "second"):
        result = command("run", wheeled_folder, "--out", out)
        assert (result.returncode, result.stderr) == (0, "")
        assert {path.name for path in out.iterdir()} == OUTPUTS | FUSED
        outputs.append([(out / name).read_bytes() for name in sorted(FUSED)])
    assert outputs[0] == outputs[1]

    summary = summary_of(tmp_path / "first")
    assert {"slips", "fusion"} <= set(summary)
    source = str(wheeled_folder / "encoders.csv")
    assert summary["wheels"] == {"source": source, "unit": "ticks", "samples": FRAMES, "dropped": 0}
    assert summary["scale"]["value"] > 0
    assert len(read_tum(tmp_path / "first" / "fused.tum")) == FRAMES - 1
    assert len(read_tum(tmp_path / "first" / "fused_smoothed.tum")) == summary["keyframes"]
    way_m = read_tum(tmp_path / "first" / "wheel.tum").positions[-1]
    np.testing.assert_allclose(way_m, [39 * 52 / 4096 * 2 * np.pi * 0.1, 0, 0], atol=1e-6)


def test_results_of_an_earlier_run_do_not_stay_beside_those_of_another(wheeled_folder, command, tmp_path):
    """They would be judged as its own."""
    out = tmp_path / "out"
    assert command("run", wheeled_folder, "--out", out).returncode == 0
    (out / "notes.txt").write_text("mine")
    (wheeled_folder / "encoders.csv").unlink()
    result = command("run", wheeled_folder, "--out", out)
    assert result.returncode == 0
    assert {path.name for path in out.iterdir()} == {*OUTPUTS, "notes.txt"}
    for name in FUSED:
        assert f"{out / name}: of an earlier run, was removed" in result.stderr


def test_settings_of_the_fusion(wheeled_folder, command, tmp_path):
    fixed = ("--set", "fusion.graph.window=30", "--set", "window.active_points=300")
    assert command("run", wheeled_folder, "--out", tmp_path / "set", *fixed).returncode == 0
    again = tmp_path / "set" / "fusion.yaml"
    assert load_settings(again, [], FusionConfig).graph.window == 30
    assert load_settings(tmp_path / "set" / "config.yaml").window.active_points == 300
    assert command("run", wheeled_folder, "--out", tmp_path / "file", "--fusion-config", again).returncode == 0
    assert (tmp_path / "file" / "fusion.yaml").read_bytes() == again.read_bytes()
    wrong = command("run", wheeled_folder, "--out", tmp_path / "wrong", "--set", "fusion.graph.window=3")
    assert_refused(wrong, "graph.window")


def test_a_part_of_a_recording(wheeled_folder, command, tmp_path):
    stamps_s = np.array([float(line.split()[1]) for line in (wheeled_folder / "times.txt").read_text().splitlines()])
    start_s, duration_s = 0.31, 0.52
    part = ("--start", f"{start_s}", "--duration", f"{duration_s}")
    assert command("run", wheeled_folder, "--out", tmp_path / "out", *part).returncode == 0
    since_s = stamps_s - stamps_s[0]
    assert summary_of(tmp_path / "out")["frames"] == np.sum((since_s >= start_s) & (since_s <= start_s + duration_s))


@pytest.mark.parametrize(
    ("part", "reason"),
    [
        (("--start", "-1"), "--start -1: 0 to 1e+06 seconds"),
        (("--duration", "nan"), "--duration nan: 0 to 1e+06 seconds"),
        (("--start", "5000"), "--start 5000: the last image comes before that"),
    ],
)
def test_parts_that_are_none_are_refused(tum_folder, command, tmp_path, part, reason):
    assert_refused(command("run", tum_folder, "--out", tmp_path / "out", *part), reason)


def test_the_wheels_predict_unless_told_otherwise(wheeled_folder, command, tmp_path):
    def camera(*options):
        assert command("run", wheeled_folder, "--out", tmp_path / "out", *options).returncode == 0
        return (tmp_path / "out" / "camera.tum").read_bytes()

    predicted, alone = camera(), camera("--no-prediction")
    (wheeled_folder / "encoders.csv").unlink()
    assert alone == camera()
    assert alone != predicted


def test_wheels_of_an_unknown_robot_are_not_fused(wheeled_folder, command, tmp_path):
    (wheeled_folder / "robot.yaml").unlink()
    result = command("run", wheeled_folder, "--out", tmp_path / "out")
    assert result.returncode == 0
    assert result.stderr.startswith("warning: ")
    assert "--robot" in result.stderr
    assert {path.name for path in (tmp_path / "out").iterdir()} == OUTPUTS


def test_wheels_of_another_time_are_not_fused(wheeled_folder, command, tmp_path):
    encoders = wheeled_folder / "encoders.csv"
    encoders.write_text(encoders.read_text().replace("17000000", "17000900"))
    result = command("run", wheeled_folder, "--out", tmp_path / "out")
    assert result.returncode == 0
    assert result.stderr.startswith(f"warning: {encoders}: the wheels and the images do not overlap in time: ")
    assert result.stderr.endswith(" after the last image; the wheels are not used\n")
    assert {path.name for path in (tmp_path / "out").iterdir()} == OUTPUTS
    assert summary_of(tmp_path / "out")["warnings"] == [result.stderr[len("warning: ") : -1]]


def test_a_camera_that_looks_down_is_refused(wheeled_folder, command, tmp_path):
    robot = wheeled_folder / "robot.yaml"
    robot.write_text(robot.read_text().replace("[0, 0, 0, 1]", "[1, 0, 0, 0]"))
    assert_refused(command("run", wheeled_folder, "--out", tmp_path / "out"), str(wheeled_folder), "must look up")


def test_other_topics_of_a_bag(tum_folder, bag_of, command, tmp_path):
    bag = bag_of(tum_folder, image_topic="/cam/mono", info_topic="/calibration")
    topics = ("--image-topic", "/cam/mono", "--camera-info-topic", "/calibration")
    assert command("run", bag, "--out", tmp_path / "out", *topics).returncode == 0
    assert summary_of(tmp_path / "out")["tracked"] > FRAMES / 2


def test_settings_take_effect_and_a_run_can_be_repeated_from_its_own(tum_folder, command, tmp_path):
    few = ("--set", "window.active_points=300", "--set", "window.candidate_points=300")
    assert command("run", tum_folder, "--out", tmp_path / "default").returncode == 0
    assert command("run", tum_folder, "--out", tmp_path / "few", *few).returncode == 0
    config = tmp_path / "few" / "config.yaml"
    assert load_settings(config, []).window.active_points == 300
    assert command("run", tum_folder, "--out", tmp_path / "again", "--config", config).returncode == 0

    def trajectory(name):
        return (tmp_path / name / "camera.tum").read_bytes()

    assert trajectory("few") == trajectory("again") != trajectory("default")


def test_images_are_scaled_and_thinned(tum_folder, command, tmp_path):
    stamps_s = [float(line.split()[1]) for line in (tum_folder / "times.txt").read_text().splitlines()]
    fps = 0.5 * (FRAMES - 1) / (stamps_s[-1] - stamps_s[0])
    result = command("run", tum_folder, "--out", tmp_path / "out", "--size", "180x136", "--fps", str(fps))
    assert (result.returncode, result.stderr) == (0, "")
    with (tmp_path / "out" / "timing.csv").open() as file:
        used_s = [float(row["stamp"]) for row in csv.DictReader(file)]
    np.testing.assert_allclose(used_s, stamps_s[::2], atol=1e-6)


def test_images_are_left_out_as_the_motion_allows(tum_folder, command, tmp_path):
    result = command("run", tum_folder, "--out", tmp_path / "out", "--fps", "auto")
    assert (result.returncode, result.stderr) == (0, "")
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["frames"] == summary["frame_rate"]["used"]
    assert summary["frame_rate"]["used"] + summary["frame_rate"]["left_out"] == FRAMES
    assert summary["frame_rate"]["reasons"]["starting"] > 0


@pytest.mark.parametrize(
    ("option", "value", "complaint"),
    [
        ("--size", "100", "--size 100: expected WIDTHxHEIGHT"),
        ("--size", "400x300", "400x300 is larger than the images, 192x144"),
        ("--size", "190x142", "190x142 pixels: too small to be tracked, or not divisible by 4"),
        ("--fps", "-1", "--fps -1: 0 for all images, or 0.0003 (one an hour) or more a second"),
        ("--fps", "nan", "--fps nan: 0 for all images"),
        ("--fps", "1e-300", "--fps 1e-300: 0 for all images"),
        ("--fps", "fast", "--fps fast: a number, 0 for all images, or auto"),
    ],
)
def test_impossible_sizes_and_rates_are_refused(tum_folder, command, tmp_path, option, value, complaint):
    assert_refused(command("run", tum_folder, "--out", tmp_path / "out", option, value), complaint)
    assert not (tmp_path / "out").exists()


def test_bad_frames_are_warned_of_counted_and_skipped(tum_folder, command, tmp_path):
    """They cost no more poses than themselves."""
    assert command("run", tum_folder, "--out", tmp_path / "clean").returncode == 0
    truncated = tum_folder / "images" / "00020.png"
    truncated.write_bytes(truncated.read_bytes()[:500])
    cv2.imwrite(str(tum_folder / "images" / "00025.png"), np.zeros((50, 60), np.uint8))
    (tum_folder / "images" / "00030.png").unlink()
    lines = (tum_folder / "times.txt").read_text().splitlines()
    repeated = lines[10].replace("00010 ", "00011 ")
    edit(tum_folder / "times.txt", 12, repeated)
    result = command("run", tum_folder, "--out", tmp_path / "out")
    assert result.returncode == 0
    warnings = result.stderr.splitlines()
    assert len(warnings) == 4
    assert all(warning.startswith("warning: ") for warning in warnings)
    for warning, text in zip(warnings, ("00011.png", "00020.png", "00025.png", "line 31")):
        assert text in warning
    summary = summary_of(tmp_path / "out")
    assert summary["frames"] == FRAMES - 4
    assert [f"warning: {warning}" for warning in summary["warnings"]] == warnings
    assert summary["tracked"] > FRAMES / 2
    assert summary["tracked"] >= summary_of(tmp_path / "clean")["tracked"] - 4


def test_missing_input(command, tmp_path):
    assert_refused(command("run", tmp_path / "nothing", "--out", tmp_path / "out"), "nothing")
    assert not (tmp_path / "out").exists()


def test_empty_folder(command, tmp_path):
    (tmp_path / "empty").mkdir()
    assert_refused(command("run", tmp_path / "empty", "--out", tmp_path / "out"), "empty", "images")


def test_unreadable_bag(command, tmp_path):
    (tmp_path / "broken.bag").write_bytes(b"#ROSBAG V2.0\nand then nothing")
    assert_refused(command("run", tmp_path / "broken.bag", "--out", tmp_path / "out"), "broken.bag")


def test_topic_that_is_not_in_the_bag(tum_folder, bag_of, command, tmp_path):
    bag = bag_of(tum_folder)
    assert_refused(
        command("run", bag, "--out", tmp_path / "out", "--image-topic", "/front"), "tour.bag", "/front", IMAGE
    )


def test_bag_without_camera_info_needs_a_camera_file(tum_folder, bag_of, command, tmp_path):
    bag = bag_of(tum_folder, info_topic=None)
    out = ("--out", tmp_path / "out")
    assert_refused(command("run", bag, *out), "tour.bag", "/camera/up/camera_info")
    assert command("run", bag, *out, "--camera", tum_folder / "camera.txt").returncode == 0


@pytest.mark.parametrize(
    ("line", "text"), [(1, "Pinhole 120 120 95.5"), (1, "Pinhole nan 120 95.5 71.5 0"), (2, "192"), (3, "cut")]
)
def test_wrong_line_in_the_camera_file(tum_folder, command, tmp_path, line, text):
    edit(tum_folder / "camera.txt", line, text)
    result = command("run", tum_folder, "--out", tmp_path / "out")
    assert_refused(result, "camera.txt, line " + str(line), "expected")


def test_wrong_robot_file(tum_folder, command, tmp_path):
    robot = tmp_path / "robot.yaml"
    robot.write_text("ticks_per_turn: none\n")
    assert_refused(
        command("run", tum_folder, "--out", tmp_path / "out", "--robot", robot), "robot.yaml", "ticks_per_turn"
    )


@pytest.mark.parametrize("setting", ["window.frames=3", "window.max_keyframes=x", "window.max_keyframes=0"])
def test_wrong_setting(tum_folder, command, tmp_path, setting):
    assert_refused(command("run", tum_folder, "--out", tmp_path / "out", "--set", setting), setting.partition("=")[0])


def test_unwritable_folder(tum_folder, command, tmp_path):
    (tmp_path / "file").write_text("")
    assert_refused(command("run", tum_folder, "--out", tmp_path / "file"), "file", "File exists")
    assert_refused(command("run", tum_folder, "--out", tmp_path / "file" / "out"), "file/out", "Not a directory")


def test_usage_errors(tum_folder, command):
    assert_refused(command("run", tum_folder), "--out")
    assert_refused(command("fly"), "fly")
    assert_refused(command(), "COMMAND")
