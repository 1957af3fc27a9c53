# SPDX-License-Identifier: BSD-3-Clause
import os
from pathlib import Path

import numpy as np
import pytest
from bag_conversion import write_recording_as_bag

from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.opening import open_recording
from ceiling_dso_ros.io.preprocessing import ImagePreprocessor

DATA = Path(os.environ.get("CEILING_DSO_DATA", Path(__file__).parents[3] / "shared" / "data"))


def assert_same_frames(folder, bag):
    frames = list(zip(folder.frames(), bag.frames()))
    assert len(frames) == len(folder) == len(bag)
    for expected, actual in frames:
        assert (actual.stamp_ns, actual.exposure_ms) == (expected.stamp_ns, expected.exposure_ms)
        np.testing.assert_array_equal(actual.image, expected.image)


def convert(folder, path, **arguments):
    write_recording_as_bag(open_recording(folder), path)
    return open_recording(path, **arguments)


def test_a_bag_holds_what_the_folder_holds(tum_folder, tmp_path):
    robot_file = tmp_path / "robot.yaml"
    robot_file.write_text((tum_folder / "robot.yaml").read_text().split("T_base_camera")[0])
    folder, bag = open_recording(tum_folder), convert(tum_folder, tmp_path / "tour.bag", robot_file=robot_file)

    assert_same_frames(folder, bag)
    assert bag.calibration == folder.calibration
    for name in ("stamps_ns", "readings"):
        np.testing.assert_array_equal(getattr(bag.wheels, name), getattr(folder.wheels, name))
    np.testing.assert_allclose(bag.robot.T_base_camera, folder.robot.T_base_camera, atol=1e-15)


@pytest.mark.parametrize(
    "lens",
    [
        "RadTan 60 61 47.5 39.5 -0.2 0.05 0.001 -0.001",
        "EquiDistant 60 61 47.5 39.5 0.01 0.04 -0.03 0.01",
        "EquiDistant 60 61 47.5 39.5 0 0 0 0",
    ],
)
def test_lenses_survive(tum_folder, tmp_path, lens):
    (tum_folder / "camera.txt").write_text(f"{lens}\n96 80\ncrop\n96 80\n")
    folder, bag = open_recording(tum_folder), convert(tum_folder, tmp_path / "tour.bag")
    assert bag.calibration.camera == folder.calibration.camera
    from_folder, from_bag = (ImagePreprocessor(recording.calibration) for recording in (folder, bag))
    raw = next(folder.frames()).image
    np.testing.assert_array_equal(from_bag(raw), from_folder(raw))


@pytest.mark.parametrize(
    "camera",
    [
        "FOV 0.6 0.7 0.5 0.5 0.9\n96 80\ncrop\n96 80\n",
        "RadTan 60 61 47.5 39.5 -0.2 0.05 0.001 -0.001\n96 80\nfull\n96 80\n",
    ],
)
def test_what_a_camera_info_cannot_say_needs_the_camera_file(tum_folder, tmp_path, camera):
    (tum_folder / "camera.txt").write_text(camera)
    with pytest.raises(InputError, match="no camera_info on /camera/up/camera_info"):
        convert(tum_folder, tmp_path / "tour.bag")
    bag = open_recording(tmp_path / "tour.bag", camera_file=tum_folder / "camera.txt")
    assert_same_frames(open_recording(tum_folder), bag)


def test_unreadable_images_are_left_out(tum_folder, tmp_path):
    (tum_folder / "images" / "00002.png").write_bytes(b"no image")
    bag = convert(tum_folder, tmp_path / "tour.bag")
    assert len(bag) == len(open_recording(tum_folder)) - 1


@pytest.mark.long
@pytest.mark.parametrize("name", ["tum_fr1_xyz", "ceiling_loops"])
def test_real_recordings(tmp_path, name):
    if not (DATA / name).is_dir():
        pytest.skip(f"{DATA / name} is missing: set CEILING_DSO_DATA to the folder of the recordings")
    folder, bag = open_recording(DATA / name), convert(DATA / name, tmp_path / "tour.bag")
    assert bag.calibration == folder.calibration
    assert_same_frames(folder, bag)
