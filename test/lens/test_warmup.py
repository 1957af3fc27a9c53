# SPDX-License-Identifier: BSD-3-Clause
"""The warm-up reaches every kernel of the lens's calibration, or says that it did not."""

import os
import subprocess
import sys
from pathlib import Path

from ceiling_dso_ros.lens import warmup


def test_what_a_calibration_does_compiles_nothing_more():
    """In a process of its own: what other tests have compiled does not count."""
    script = """
from dataclasses import replace
import numpy as np
from synthetic_drive import LENS, ROBOT, synthetic_drive
from ceiling_dso_ros.dso.compute import jit
from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.dso.geometry.projection import viewing_rays
from ceiling_dso_ros.dso.warmup import textured_plane
from ceiling_dso_ros.lens import warmup
from ceiling_dso_ros.lens.finding import find
from ceiling_dso_ros.lens.tracks import SeenKeyframe, follow

def signatures():
    return sum(len(kernel.signatures) for kernel in jit._compiled)

assert warmup.warm_up()
warm = signatures()
camera = PinholeCamera(150.0, 150.0, 119.5, 79.5, 240, 160)
u, v = (axis.ravel() for axis in np.meshgrid(np.arange(6, 230, 12.0), np.arange(6, 150, 12.0)))
rays = viewing_rays(camera.parameters, u, v)
keyframes = []
for number in range(4):
    T = np.eye(4)
    T[0, 3] = 0.02 * number
    image = np.clip(textured_plane(camera, 0.02 * number), 0.0, 255.0).astype(np.uint8)
    keyframes.append(SeenKeyframe(number, 0, T, image, camera, rays.astype(np.float32)))
assert len(follow(keyframes, LENS).target) > 10
drive = synthetic_drive(0)
find(drive.keyframes, drive.tracks, drive.steps, ROBOT, replace(ROBOT, T_base_camera=drive.T_base_camera), LENS, LENS)
print(warm, signatures())
"""
    folders = [str(Path(__file__).parent), *(path for path in sys.path if path)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(folders)}
    result = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True)
    before, after = map(int, result.stdout.split()[-2:])
    assert before == after > 0


def test_it_says_when_it_did_not(monkeypatch, capsys):
    monkeypatch.setattr(warmup, "warm_up", lambda: False)
    monkeypatch.setattr(warmup, "_marker", lambda: None)
    assert warmup.main() == 1
    assert "not compiled" in capsys.readouterr().err
