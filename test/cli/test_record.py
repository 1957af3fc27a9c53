# SPDX-License-Identifier: BSD-3-Clause
"""`record` with cameras that are plugged in by the test."""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "drivers"))

from fake_bench import STAND_IN, FakeBench, exposure_ms_of, truth_of

from ceiling_dso_ros.cli import record
from ceiling_dso_ros.cli.main import main
from ceiling_dso_ros.io.bag_reader import read_messages
from ceiling_dso_ros.io.opening import open_recording
from ceiling_dso_ros.io.recording import TopicNames

SMALL = ("--size", "424x240")


@pytest.fixture
def bench(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(STAND_IN))
    bench = FakeBench(tmp_path / "bench")
    monkeypatch.setenv("FAKE_REALSENSE", str(bench.folder))
    return bench


def require_right(path, topics=TopicNames(), index=1):
    """All images in order, with their exposures; returns how many."""
    recording = open_recording(path, topics)
    images = list(recording.images())
    truths = [truth_of(image.decode()) for image in images]
    numbers = [number for number, _, _ in truths]
    assert numbers == sorted(set(numbers))
    assert {stream for _, _, stream in truths} == {index}
    assert [image.exposure_ms for image in images] == pytest.approx([exposure_ms_of(number) for number in numbers])
    errors_ns = np.array([image.stamp_ns - true_ns for image, (_, true_ns, _) in zip(images, truths)])
    assert np.abs(errors_ns).max() < 20_000_000
    return len(images)


def test_a_camera_is_recorded_in_the_packages_own_form(bench, tmp_path, capsys):
    bench.plug_in()
    bag = tmp_path / "drive.bag"
    assert main(["record", "--out", str(bag), "--duration", "4", "--stereo", "--imu", *SMALL]) == 0
    count = require_right(bag)
    assert count > 30
    right = TopicNames(image="/camera/up_right/image_raw")
    assert require_right(bag, right, index=2) == count
    (transforms,) = [raw.content().transforms for raw in read_messages(bag, ["/tf_static"])]
    assert {transform.child_frame_id: transform.transform.translation.x for transform in transforms} == {
        "camera_up_right_optical_frame": 0.095,
        "camera_up_imu_optical_frame": 0.03,
    }
    infos = [raw.content() for raw in read_messages(bag, ["/camera/up_right/camera_info"])]
    assert infos[0].P[3] == pytest.approx(-0.095 * infos[0].K[0])
    assert len(list(read_messages(bag, ["/camera/imu"]))) > 200
    output = capsys.readouterr().out
    assert "recording Intel RealSense D455 1111, firmware 5.16.0.1, USB 3.2, 424x240 at 30 Hz" in output
    numbers = [truth_of(image.decode())[0] for image in open_recording(bag).images()]
    missing = numbers[-1] - numbers[0] + 1 - count  # on a busy computer
    (dropped,) = map(int, re.findall(rf"{count} images, (\d+) dropped", output))
    assert dropped >= missing  # images of the first second, which are not written, may be missing as well


@pytest.mark.long
def test_a_camera_that_is_away_meanwhile(bench, tmp_path, capsys):
    bench.plug_in()
    bag = tmp_path / "drive.bag"
    words = [sys.executable, "-m", "ceiling_dso_ros", "record", "--out", str(bag), *SMALL]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)
    try:
        assert process.stdout.readline().startswith("recording ")
        bench.unplug()
        for line in process.stderr:
            if "is not connected" in line:
                break
        bench.plug_in(usb="2.1")
        for line in process.stderr:
            if "USB 2.1" in line:
                break
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(3.0)
    finally:
        process.send_signal(signal.SIGINT)  # the usual end
    assert process.wait(60.0) == 0
    assert require_right(bag) > 10


def test_without_a_camera_no_bag_is_begun(bench, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(record, "WAIT_S", 2.0)
    assert main(["record", "--out", str(tmp_path / "drive.bag")]) == 2
    assert capsys.readouterr().err == "error: no RealSense camera is connected\n"
    assert [path.name for path in tmp_path.iterdir()] == ["bench"]


def test_the_disk_is_not_filled(bench, tmp_path, capsys):
    bench.plug_in()
    bag = tmp_path / "drive.bag"
    assert main(["record", "--out", str(bag), "--keep-free", "1e9", *SMALL]) == 0
    assert "the recording ends: the disk has" in capsys.readouterr().err
    assert bag.exists()


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["--fps", "100"], "100 images a second: 6 to 90"),
        (["--size", "8x"], "--size"),
        (["--exposure", "500"], "exposure of 500 ms: 0.02 to 165, or 0"),
        (["--duration", "-1"], "--duration -1: 0 or more"),
        (["--metering", "3"], "metering 3: 0.05 to 1, or 0"),
    ],
)
def test_wrong_options_are_refused_in_one_line(options, complaint, tmp_path, capsys):
    assert main(["record", "--out", str(tmp_path / "drive.bag"), *options]) == 2
    error = capsys.readouterr().err
    assert complaint in error
    assert error.count("\n") == 1
