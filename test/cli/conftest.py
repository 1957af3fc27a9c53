# SPDX-License-Identifier: BSD-3-Clause
"""A small recording that the odometry can track, and the command line as users call it."""

import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from ceiling_dso_ros.io.bag_writer import BagWriter
from ceiling_dso_ros.io.opening import open_recording

ROOT = Path(__file__).parents[2]
WIDTH, HEIGHT, COUNT = 192, 144, 40
START_NS, PERIOD_NS = 1_700_000_001_030_042_017, 33_333_333
FOCAL_PX = 120.0
ROBOT = """ticks_per_turn: 4096
wheel_radius: [0.1, 0.1]
wheel_base: 0.5
T_base_camera: {xyz: [0.18, 0.0, 0.62], quat_xyzw: [0, 0, 0, 1]}
"""


def stamp(index):
    nanoseconds = START_NS + index * PERIOD_NS
    return f"{nanoseconds // 10**9}.{nanoseconds % 10**9:09d}"


def pictures():
    """What a camera sees that drives along a ceiling of beams in front of panels, twice as near."""
    rng = np.random.default_rng(7)
    panels, beams = (cv2.GaussianBlur(rng.uniform(0, 255, (HEIGHT, 500)), (0, 0), 1.5) for _ in range(2))
    panels, beams = ((layer - layer.mean()) * 50 / layer.std() + 120 for layer in (panels, beams))
    x, y = np.meshgrid(np.arange(WIDTH, dtype=np.float32), np.arange(HEIGHT, dtype=np.float32))
    for index in range(COUNT):
        far = cv2.remap(panels, x + 0.8 * index, y, cv2.INTER_LINEAR)
        near = cv2.remap(beams, x + 1.6 * index, y, cv2.INTER_LINEAR)
        on_beam = (x + 1.6 * index) % 80 < 30
        yield np.clip(np.where(on_beam, near, far), 0, 255).astype(np.uint8)


@pytest.fixture
def tum_folder(tmp_path):
    """A folder in the TUM-mono layout, to be changed at will."""
    return write_tum_folder(tmp_path)


@pytest.fixture(scope="module")
def tum_folder_of_module(tmp_path_factory):
    """The same for all tests of a file, which leave it as it is."""
    return write_tum_folder(tmp_path_factory.mktemp("recording"))


def write_tum_folder(parent):
    folder = parent / "tour"
    (folder / "images").mkdir(parents=True)
    for index, picture in enumerate(pictures()):
        cv2.imwrite(str(folder / "images" / f"{index:05d}.png"), picture)
    (folder / "times.txt").write_text("".join(f"{index:05d} {stamp(index)} 5.5\n" for index in range(COUNT)))
    size = f"{WIDTH} {HEIGHT}"
    lens = f"Pinhole {FOCAL_PX} {FOCAL_PX} {WIDTH / 2 - 0.5} {HEIGHT / 2 - 0.5} 0"
    (folder / "camera.txt").write_text(f"{lens}\n{size}\nnone\n{size}\n")
    return folder


@pytest.fixture
def wheeled_folder(tum_folder):
    """The same with wheels that drive as fast as the camera sees."""
    stamps = [line.split()[1] for line in (tum_folder / "times.txt").read_text().splitlines()]
    rows = [f"{stamp},{7 + 52 * index},{7 + 52 * index}\n" for index, stamp in enumerate(stamps)]
    (tum_folder / "encoders.csv").write_text("stamp,left,right\n" + "".join(rows))
    (tum_folder / "robot.yaml").write_text(ROBOT)
    return tum_folder


@pytest.fixture(scope="session")
def bag_of(tmp_path_factory):
    """Rewrite the recording of a folder as a ROS 1 bag."""

    def write(folder, image_topic="/camera/up/image_raw", info_topic="/camera/up/camera_info"):
        recording = open_recording(folder)
        lens = recording.calibration.lens
        K = np.array([[lens.fx, 0.0, lens.cx], [0.0, lens.fy, lens.cy], [0.0, 0.0, 1.0]])
        path = tmp_path_factory.mktemp("bag") / f"{recording.name}.bag"
        with BagWriter(path) as bag:
            for listed in recording.images():
                if info_topic is not None:
                    bag.camera_info(info_topic, listed.stamp_ns, "camera", (lens.width, lens.height), K)
                if listed.exposure_ms is not None:
                    exposure_topic = image_topic.rpartition("/")[0] + "/exposure"
                    bag.exposure(exposure_topic, listed.stamp_ns, "camera", listed.exposure_ms)
                bag.image(image_topic, listed.stamp_ns, "camera", listed.decode())
        return path

    return write


@pytest.fixture(scope="session")
def command():
    """Run `python3 -m ceiling_dso_ros WORDS` in a process of its own."""

    def run(*words, interpreter_options=()):
        return subprocess.run(
            [sys.executable, *interpreter_options, "-m", "ceiling_dso_ros", *map(str, words)],
            env={**os.environ, "PYTHONPATH": str(ROOT / "src")},
            capture_output=True,
            text=True,
        )

    return run
