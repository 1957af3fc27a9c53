# SPDX-License-Identifier: BSD-3-Clause
"""Runs that are interrupted, lose tracking or fail: what was computed before is written."""

import fcntl
import json
import os
import re
import signal
import struct
import subprocess
import sys
import termios

import cv2
import numpy as np
import pytest

from ceiling_dso_ros import dso
from ceiling_dso_ros.cli.main import main
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.trajectory import read_tum
from ceiling_dso_ros.io.tum_folder import TumFolderRecording
from ceiling_dso_ros.playback import visual_run

pytestmark = pytest.mark.long  # each command is a process of its own, which loads all kernels
FRAMES = 40
TRAJECTORIES = ("camera.tum", "camera_final.tum", "keyframes.tum")
OUTPUTS = {*TRAJECTORIES, "map.ply", "timing.csv", "config.yaml", "summary.json"}


def summary_of(folder):
    return json.loads((folder / "summary.json").read_text())


ENDLESS = 20_000  # images


def make_endless(tum_folder):
    """The camera goes back and forth over the same images."""
    there_and_back = [*range(FRAMES), *range(FRAMES - 2, 0, -1)]
    images = tum_folder / "images"
    with (tum_folder / "times.txt").open("w") as file:
        for index in range(ENDLESS):
            (images / f"{100_000 + index}.png").symlink_to(f"{there_and_back[index % len(there_and_back)]:05d}.png")
            file.write(f"{100_000 + index} {1000 + index / 30:.6f} 5.5\n")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_run_keeps_what_it_has(tum_folder, tmp_path, read_ply, number):
    """On a terminal, where the progress bar says when there is something to keep."""
    make_endless(tum_folder)
    out = tmp_path / "out"
    try:
        terminal, its_other_end = os.openpty()
    except OSError as error:
        pytest.skip(f"no pseudo terminals here: {error}")
    fcntl.ioctl(its_other_end, termios.TIOCSWINSZ, struct.pack("HHHH", 25, 100, 0, 0))
    process = subprocess.Popen(
        [sys.executable, "-m", "ceiling_dso_ros", "run", str(tum_folder), "--out", str(out)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        stdout=subprocess.DEVNULL,
        stderr=its_other_end,
    )
    os.close(its_other_end)
    shown = ""
    while not re.search(rf" [1-9]\d\d+/{ENDLESS}", shown):
        shown += os.read(terminal, 1000).decode()
    process.send_signal(number)
    while True:
        try:
            shown += os.read(terminal, 1000).decode()
        except OSError:  # how Linux reports that the other end was closed
            break
    os.close(terminal)
    assert process.wait() == 130
    assert shown.splitlines()[-1] == "error: interrupted"
    summary = summary_of(out)
    assert summary["end"] == "interrupted"
    assert 100 <= summary["frames"] < ENDLESS
    assert len(read_tum(out / "camera.tum")) == len(read_tum(out / "camera_final.tum")) == summary["tracked"] > 0
    assert {path.name for path in out.iterdir()} == OUTPUTS
    assert max(read_ply(out / "map.ply")["keyframe_id"]) < summary["keyframes"]


def test_the_map_has_the_points_of_a_segment_that_was_lost(tum_folder, tmp_path, monkeypatch, read_ply):
    """The camera is covered to the end: nothing follows that has a map."""
    for index in range(30, FRAMES):
        cv2.imwrite(str(tum_folder / "images" / f"{index:05d}.png"), np.zeros((144, 192), np.uint8))
    maps = [None]

    class Watched(dso.DirectOdometry):
        def track(self, *arguments):
            status = super().track(*arguments)
            if self.map is not None and self.map is not maps[-1]:
                maps.append(self.map)
            return status

    monkeypatch.setattr(visual_run, "DirectOdometry", Watched)
    small = ("--set", "window.max_keyframes=3", "--set", "window.min_keyframes=2")  # so that points leave it
    impatient = ("--set", "tracking.patience=0.1")
    assert main(["run", str(tum_folder), "--out", str(tmp_path / "out"), *small, *impatient]) == 0
    assert summary_of(tmp_path / "out")["lost"] == 1
    vertices = read_ply(tmp_path / "out" / "map.ply")
    left = sum(len(each.marginalized) for each in maps[1:])
    assert left > 100
    assert len(vertices["x"]) == left + len(maps[-1].window_points)
    assert set(vertices["segment"]) == {0}
    assert len(set(vertices["keyframe_id"])) > 2
    assert vertices["red"] == vertices["green"] == vertices["blue"]


def failing_at(frame, error):
    """A DirectOdometry that raises error at a frame, counted from 1."""

    class Failing(dso.DirectOdometry):
        count = 0

        def track(self, *arguments):
            self.count += 1
            if self.count == frame:
                raise error
            return super().track(*arguments)

    return Failing


@pytest.mark.parametrize(
    ("error", "code", "end", "line"),
    [
        (
            RuntimeError("no more\nideas"),
            1,
            "failed: RuntimeError: no more\nideas",
            "error: RuntimeError: no more ideas",
        ),
        (KeyboardInterrupt(), 130, "interrupted", "error: interrupted"),
    ],
)
def test_a_failed_run_keeps_what_it_has(tum_folder, tmp_path, monkeypatch, capsys, error, code, end, line):
    monkeypatch.setattr(visual_run, "DirectOdometry", failing_at(30, error))
    assert main(["run", str(tum_folder), "--out", str(tmp_path / "out")]) == code
    summary = summary_of(tmp_path / "out")
    assert summary["end"] == end
    assert summary["frames"] == 29
    assert len(read_tum(tmp_path / "out" / "camera.tum")) == summary["tracked"] > 0
    (complaint,) = capsys.readouterr().err.splitlines()
    assert complaint.startswith(line)


def test_a_bag_that_is_damaged_further_on_keeps_what_came_before(tum_folder, tmp_path, monkeypatch, capsys):
    """Reading fails as it does for a bag whose later chunk is broken: the input is to blame, not the run."""
    whole = TumFolderRecording.images

    def damaged(recording):
        for index, image in enumerate(whole(recording)):
            if index == 30:
                raise InputError("tour.bag: the chunk at 12345 is damaged")
            yield image

    monkeypatch.setattr(TumFolderRecording, "images", damaged)
    assert main(["run", str(tum_folder), "--out", str(tmp_path / "out")]) == 2
    assert summary_of(tmp_path / "out")["frames"] == 30
    assert capsys.readouterr().err == "error: tour.bag: the chunk at 12345 is damaged\n"
