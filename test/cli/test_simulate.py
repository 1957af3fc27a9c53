# SPDX-License-Identifier: BSD-3-Clause
import argparse
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml

from ceiling_dso_ros.cli import simulate
from ceiling_dso_ros.cli.main import main
from ceiling_dso_ros.io.bag_reader import open_bag
from ceiling_dso_ros.io.opening import open_recording
from ceiling_dso_ros.simulation.config import SimulationConfig

ROOT = Path(__file__).parents[2]
QUICK = ("--ceiling", "plaster", "--size", "104x64", "--duration", "1")


def options(*words):
    parser = argparse.ArgumentParser()
    simulate.add_parser(parser.add_subparsers())
    return parser.parse_args(["simulate", *words])


def test_the_defaults_are_those_of_the_simulation():
    assert simulate._config(options("loops", "--out", "a.bag")) == SimulationConfig("loops")


def test_a_wrong_calibration_is_told_and_the_truth_is_beside_it(tmp_path):
    out = tmp_path / "a.bag"
    assert main(["simulate", "loops", "--out", str(out), *QUICK, "--lens-error", "0.01", "3", "-2", "0.02"]) == 0
    lens = open_recording(out).calibration.lens
    fx, _, cx, cy = yaml.safe_load((tmp_path / "a.truth.yaml").read_text())["camera_fx_fy_cx_cy"]
    assert (lens.fx, lens.cx, lens.cy) == pytest.approx((1.01 * fx, cx + 3.0, cy - 2.0))
    assert (lens.model, lens.distortion) == ("RadTan", (0.02, 0.0, 0.0, 0.0, 0.0))


def test_a_wrong_lens_is_drawn_by_the_seed():
    errors = [
        simulate._config(options("loops", "--out", "a.bag", "--wrong-lens", "--seed", str(seed))).camera.lens_error
        for seed in (3, 3, 4)
    ]
    assert errors[0] == errors[1] != errors[2]
    assert simulate._config(options("loops", "--out", "a.bag", "--ceiling", "random")).camera.lens_error == ()


def test_every_option_reaches_the_simulation():
    config = simulate._config(
        options(
            *("spin", "--out", "a.bag", "--ceiling", "tiles", "--seed", "7", "--duration", "12", "--fps", "15"),
            *("--size", "424x240", "--event", "slip", "--event", "cover@3+2", "--read-noise", "1", "--shot-noise", "2"),
            *("--response-gamma", "1.5", "--vignette", "0.3", "--distortion", "-0.1", "0.01", "0", "0"),
            *(
                "--time-offset",
                "0.005",
                "--radius-error",
                "0.02",
                "--ratio-error",
                "0.03",
                "--wheel-base-error",
                "0.04",
            ),
            *("--travel-noise", "0.001", "--tick-noise", "2", "--stereo", "--forward", "--imu"),
        )
    )
    camera, wheels = config.camera, config.wheels
    assert (config.sequence, config.ceiling, config.seed, config.duration_s) == ("spin", "tiles", 7, 12.0)
    assert (camera.width, camera.height, camera.fps, camera.read_noise, camera.shot_noise) == (424, 240, 15.0, 1.0, 2.0)
    assert (camera.response_gamma, camera.vignette, camera.distortion) == (1.5, 0.3, (-0.1, 0.01, 0.0, 0.0))
    assert (wheels.radius, wheels.ratio, wheels.wheel_base) == (0.02, 0.03, 0.04)
    assert (wheels.travel_noise_m, wheels.tick_noise, config.time_offset_s) == (0.001, 2.0, 0.005)
    assert config.events == ("slip", "cover@3+2")
    assert config.stereo and config.forward and config.imu


def test_a_bag_is_written_with_the_truth_beside_it(tmp_path, capsys):
    bag = tmp_path / "drive.bag"
    assert main(["simulate", "square", "--out", str(bag), *QUICK]) == 0
    assert len(open_recording(bag)) == 29
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "drive.bag",
        "drive.groundtruth.tum",
        "drive.groundtruth_base.tum",
        "drive.robot.yaml",
        "drive.truth.yaml",
    ]
    assert "29 images" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("circle",), "circle"),
        (("square", "--ceiling", "sky"), "sky"),
        (("square", "--size", "850x480"), "850x480"),
        (("square", "--size", "big"), "big"),
        (("square", "--event", "fire"), "fire"),
        (("square", "--duration", "-3"), "-3"),
        (("square", "--duration", "nan"), "nan"),
        (("square", "--seed", "-1"), "-1"),
        (("square", "--ratio-error", "5"), "ratio"),
        (("square", "--fps", "0"), "fps"),
        (("square", "--seed", "x"), "x"),
    ],
)
def test_wrong_words_are_told_in_one_line(words, told, tmp_path, capsys):
    try:
        code = main(["simulate", *words, "--out", str(tmp_path / "a.bag")])
    except SystemExit as stop:  # argparse's own
        code = stop.code
    error = capsys.readouterr().err.strip()
    assert code == 2
    assert told in error and "\n" not in error
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize("name", ["nowhere/a.bag", "folder"])
def test_a_path_that_cannot_be_written_is_told(name, tmp_path, capsys):
    (tmp_path / "folder").mkdir()
    assert main(["simulate", "square", "--out", str(tmp_path / name), *QUICK]) == 2
    error = capsys.readouterr().err.strip()
    assert name.split("/")[0] in error and "\n" not in error


def test_a_full_disk_leaves_nothing_but_one_line(tmp_path, capsys):
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # a write beyond the limit fails as on a full disk
    resource.setrlimit(resource.RLIMIT_FSIZE, (150_000, limit[1]))
    try:
        code = main(["simulate", "square", "--out", str(tmp_path / "a.bag"), *QUICK])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
        signal.signal(signal.SIGXFSZ, before)
    error = capsys.readouterr().err.strip()
    assert code == 1
    assert "a.bag" in error and "removed" in error and "\n" not in error
    assert not [*tmp_path.iterdir()]


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupted_it_leaves_a_readable_bag(number, tmp_path):
    bag = tmp_path / "long.bag"
    process = subprocess.Popen(
        [sys.executable, "-m", "ceiling_dso_ros", "simulate", "loops", "--out", str(bag), *QUICK, "--duration", "600"],
        env={**os.environ, "PYTHONPATH": str(ROOT / "src")},
        stderr=subprocess.PIPE,
        text=True,
    )
    active = tmp_path / "long.bag.active"
    for _ in range(600):
        if active.exists() and active.stat().st_size > 500_000:
            break
        time.sleep(0.1)
    process.send_signal(number)
    _, error = process.communicate(timeout=60)
    assert process.returncode != 0
    assert "Traceback" not in error
    with open_bag(bag) as reader:
        assert reader.message_count > 100
