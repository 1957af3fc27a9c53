# SPDX-License-Identifier: BSD-3-Clause
import re

import numpy as np
import pytest

from ceiling_dso_ros.io.camera_models import camera_file, read_camera_file
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.lens_models import LensCamera


def read(tmp_path, *lines):
    path = tmp_path / "camera.txt"
    path.write_text("\n".join(lines) + "\n")
    return read_camera_file(path)


def test_absolute_pinhole(tmp_path):
    calibration = read(tmp_path, "Pinhole 425.31 424.87 427.6 236.4 0", "848 480", "none", "848 480")
    assert calibration.camera.parameters.tolist() == [425.31, 424.87, 427.6, 236.4]
    assert (calibration.camera.width, calibration.camera.height) == (848, 480)
    assert calibration.keeps_images


def test_relative_numbers(tmp_path):
    calibration = read(tmp_path, "Pinhole 0.5 0.75 0.5 0.25", "640 480", "0.4 0.53 0.5 0.5 0", "320 240")
    lens, camera = calibration.lens, calibration.camera
    assert (lens.fx, lens.fy, lens.cx, lens.cy) == (320.0, 360.0, 319.5, 119.5)
    np.testing.assert_allclose(camera.parameters, [128.0, 127.2, 159.5, 119.5])
    assert (camera.width, camera.height) == (320, 240)
    assert not calibration.keeps_images


@pytest.mark.parametrize(
    ("line", "model", "distortion"),
    [
        ("RadTan 425 424 427.6 236.4 -0.28 0.07 0.001 -0.001", "RadTan", (-0.28, 0.07, 0.001, -0.001)),
        ("RadTan 425 424 427.6 236.4 0 0 0 0", "Pinhole", ()),
        ("RadTan 425 424 427.6 236.4 0.1 0 0 0 0.02", "RadTan", (0.1, 0.0, 0.0, 0.0, 0.02)),
        ("RadTan 425 424 427.6 236.4 .1 0 0 0 .02 .1 0 0", "RadTan", (0.1, 0.0, 0.0, 0.0, 0.02, 0.1, 0.0, 0.0)),
        ("EquiDistant 425 424 427.6 236.4 0.01 0.04 -0.03 0.01", "EquiDistant", (0.01, 0.04, -0.03, 0.01)),
        ("EquiDistant 425 424 427.6 236.4 0 0 0 0", "EquiDistant", (0.0, 0.0, 0.0, 0.0)),
        ("FOV 0.5 0.8 0.5 0.5 0.93", "FOV", (0.93,)),
        ("0.5 0.8 0.5 0.5 0.93", "FOV", (0.93,)),
        ("0.5 0.8 0.5 0.5 0", "Pinhole", ()),
        ("Pinhole 1.4 2.1 0.5 0.5 0", "Pinhole", ()),
    ],
)
def test_every_lens_model(tmp_path, line, model, distortion):
    lens = read(tmp_path, line, "848 480", "crop", "640 480").lens
    assert (lens.model, lens.distortion) == (model, distortion)
    assert lens.cx == pytest.approx(427.6, abs=5)


@pytest.mark.parametrize(
    ("model", "distortion"),
    [
        ("RadTan", (-0.28, 1 / 3, 0.001, -0.001)),
        ("RadTan", (0.3, 0.0, 0.0, 0.0, 0.1, 0.2, 0.0, 0.01)),
        ("EquiDistant", (0.01, 0.04, -0.03, 0.01)),
        ("FOV", (0.93,)),
        ("Pinhole", ()),
    ],
)
def test_what_is_written_is_read_back_exactly(tmp_path, model, distortion):
    lens = LensCamera(model, 425.1 + 1e-10, 424.0, 427.6, 236.4, distortion, 848, 480)
    path = tmp_path / "camera.txt"
    path.write_text(camera_file(lens, (640, 480), ["found", "in a test"]))
    found = read_camera_file(path)
    assert found.lens == lens
    assert (found.camera.width, found.camera.height) == (640, 480)
    assert path.read_text().startswith("# found\n# in a test\n")


def test_crop_and_full(tmp_path):
    line = "RadTan 425 424 427.6 236.4 -0.28 0.07 0.001 -0.001"
    crop = read(tmp_path, line, "848 480", "crop", "848 480").camera
    full = read(tmp_path, line, "848 480", "full", "848 480").camera
    assert full.fx < crop.fx < 425


@pytest.mark.parametrize(
    ("lines", "complaint"),
    [
        (["Pinhole 425 424 427 236 0", "848 480", "none"], ": 3 lines instead of 4: lens, 'width height', output"),
        (
            ["Fish 425 424 427 236", "848 480", "none", "848 480"],
            ", line 1: the lens model 'Fish' is not one of Pinhole",
        ),
        (
            ["RadTan 425 424 427 236 0.1", "848 480", "crop", "848 480"],
            ", line 1: 5 numbers; expected 'RadTan fx fy cx cy k1 k2 p1 p2'",
        ),
        (
            ["Pinhole 425 424 427 x 0", "848 480", "none", "848 480"],
            ", line 1: expected 'Pinhole fx fy cx cy 0'; could",
        ),
        (
            ["Pinhole 425 424 427 nan 0", "848 480", "none", "848 480"],
            ", line 1: expected 'Pinhole fx fy cx cy 0'; a nu",
        ),
        (
            ["Pinhole 425 424 427 236 0.1", "848 480", "none", "848 480"],
            ", line 1: the fifth number of a Pinhole must be 0",
        ),
        (
            ["Pinhole 425 424 0.5 0.5 0", "848 480", "none", "848 480"],
            ", line 1: 425 424 0.5 0.5 are neither all in pixels",
        ),
        (["Pinhole -425 424 427 236 0", "848 480", "none", "848 480"], ", line 1: -425 424 427 236 are neither"),
        (
            ["Pinhole 0 0 0.5 0.5 0", "848 480", "none", "848 480"],
            ", line 1: the focal lengths fx=0 fy=0 must be positive",
        ),
        (
            ["Pinhole 425 424 900 236 0", "848 480", "none", "848 480"],
            ", line 1: the principal point (900, 236) is outside",
        ),
        (["0.5 0.8 0.5 0.5", "848 480", "none", "848 480"], ", line 1: 4 numbers; expected 'FOV fx fy cx cy omega'"),
        (["Pinhole 425 424 427 236 0", "848", "none", "848 480"], ", line 2: '848'; expected 'width height' in pixels"),
        (["Pinhole 425 424 427 236 0", "0 480", "none", "848 480"], ", line 2: the image size 0 480 must be positive"),
        (
            ["Pinhole 425 424 427 236 0", "848 480", "corp", "848 480"],
            ", line 3: expected crop, full, none or 'fx fy cx cy",
        ),
        (
            ["Pinhole 425 424 427 236 0", "848 480", "1 2 3", "848 480"],
            ", line 3: 3 numbers; expected crop, full, none or",
        ),
        (["Pinhole 425 424 427 236 0", "848 480", "1 1 .5 .5 .1", "848 480"], ", line 3: the fifth number must be 0"),
        (
            ["Pinhole 425 424 427 236 0", "848 480", "none", "640 480"],
            ", line 3: 'none' leaves images as they are, and the",
        ),
        (
            ["FOV 0.5 0.8 0.5 0.5 0.9", "848 480", "none", "848 480"],
            ", line 3: 'none' leaves images as they are, and those",
        ),
        (["Pinhole 425 424 427 236 0", "848 480", "crop", "32 32"], ", line 3: camera: image 32x32 is too small"),
        (["Pinhole 425 424 427 236 0", "848 480", "crop", "a b"], ", line 4: 'a b'; expected 'width height' in pixels"),
    ],
)
def test_wrong_lines_are_named(tmp_path, lines, complaint):
    with pytest.raises(InputError, match=re.escape(f"{tmp_path / 'camera.txt'}{complaint}")) as caught:
        read(tmp_path, *lines)
    assert "\n" not in str(caught.value)


def test_a_camera_file_that_is_not_there(tmp_path):
    with pytest.raises(InputError, match=re.escape(f"{tmp_path / 'camera.txt'}: cannot read the file: No such file")):
        read_camera_file(tmp_path / "camera.txt")
