# SPDX-License-Identifier: BSD-3-Clause
"""Small recordings for the tests of the readers; makes the helpers of this directory importable."""

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

WIDTH, HEIGHT, COUNT = 96, 80, 6
STAMPS = [f"1700000001.{index:03d}042017" for index in range(0, 600, 100)]


def texture(index):
    x, y = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    return (127 + 60 * np.sin((x + 3 * index) / 5) + 60 * np.cos(y / 7)).astype(np.uint8)


@pytest.fixture
def tum_folder(tmp_path):
    """A complete folder in the TUM-mono layout."""
    folder = tmp_path / "tour"
    (folder / "images").mkdir(parents=True)
    for index in range(COUNT):
        cv2.imwrite(str(folder / "images" / f"{index:05d}.png"), texture(index))
    times = [f"{index:05d} {stamp} {5 + 0.1 * index}" for index, stamp in enumerate(STAMPS)]
    (folder / "times.txt").write_text("\n".join(times) + "\n")
    (folder / "camera.txt").write_text(f"Pinhole 60 61 47.5 39.5 0\n{WIDTH} {HEIGHT}\nnone\n{WIDTH} {HEIGHT}\n")
    (folder / "encoders.csv").write_text(
        "stamp,left,right\n1700000001.000000,10,-20\n1700000001.020000,15,-18\n1700000001.040000,21,-15\n"
    )
    (folder / "robot.yaml").write_text(
        "ticks_per_turn: 4096\nwheel_radius: [0.098, 0.099]\nwheel_base: 0.485\n"
        "T_base_camera:\n  xyz: [0.18, 0.04, 0.62]\n  quat_xyzw: [0, 0, 0.6, 0.8]\n"
    )
    (folder / "groundtruth.tum").write_text("1700000001 0 0 0 0 0 0 1\n")
    return folder


@pytest.fixture
def path(tmp_path):
    """Of a bag."""
    return tmp_path / "tour.bag"
