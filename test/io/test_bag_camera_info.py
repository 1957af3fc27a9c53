# SPDX-License-Identifier: BSD-3-Clause
"""Which calibration a bag has."""

import re

import numpy as np
import pytest
from small_bag import HEIGHT, INFO, WIDTH, K, stamp_ns, write_damaged, write_images, write_info

from ceiling_dso_ros.io.bag_writer import BagWriter
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.opening import open_recording
from ceiling_dso_ros.io.recording import Frame, TopicNames
from ceiling_dso_ros.io.ros_messages import message


def test_a_bag_without_camera_info(path, tmp_path):
    with BagWriter(path) as bag:
        write_images(bag)
        write_info(bag, "/front/camera_info")
    expected = (
        f"{path}: no camera_info on {INFO} (in the bag: /front/camera_info); "
        "name its topic or give a camera.txt with the calibration"
    )
    with pytest.raises(InputError, match=re.escape(expected)):
        open_recording(path)

    (tmp_path / "camera.txt").write_text("Pinhole 70 71 47.5 39.5 0\n96 80\nnone\n96 80\n")
    recording = open_recording(path, camera_file=tmp_path / "camera.txt")
    assert recording.calibration.camera.fx == 70
    assert len(list(recording.frames())) == 4


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"K": np.full((3, 3), np.nan)}, "a number of the camera is not finite; is the camera calibrated?"),
        ({"K": np.zeros((3, 3))}, "the focal lengths fx=0 fy=0 must be positive; is the camera calibrated?"),
        ({"distortion": [0.1] * 3}, "3 coefficients in D instead of 4, 5 or 8 for plumb_bob"),
    ],
)
def test_a_camera_info_of_no_camera(path, changes, complaint):
    with BagWriter(path) as bag:
        write_images(bag)
        write_info(bag, **changes)
    with pytest.raises(InputError, match=re.escape(f"{path}, {INFO}: {complaint}")):
        open_recording(path)


def test_a_damaged_camera_info(path):
    with BagWriter(path) as bag:
        write_images(bag)
        write_damaged(bag, INFO, "sensor_msgs/msg/CameraInfo")
    with pytest.raises(InputError, match=re.escape(f"{path}, {INFO}: damaged message of 3 bytes")):
        open_recording(path)


def open_noisily(path, **options):
    """The recording and its warnings."""
    warnings = []
    return open_recording(path, warn=warnings.append, **options), warnings


def change_info(**changes):
    """Write one camera_info with further fields."""

    def write(bag, index=0):
        fields = camera_info_message(stamp_ns(index))
        for name, value in changes.items():
            setattr(fields, name, value)
        bag.write(INFO, stamp_ns(index), fields)

    return write


def camera_info_message(time_ns):
    written = []

    class Kept(BagWriter):
        def __init__(self):
            self._counts = {}

        def write(self, topic, stamp_ns, content, latched=False):
            written.append(content)

    Kept().camera_info(INFO, time_ns, "optical", (WIDTH, HEIGHT), K)
    return written[0]


def test_binning_and_region_of_interest(path):
    """The images are 96x80; the sensor has 300x200."""
    region = message("sensor_msgs/RegionOfInterest", x_offset=40, y_offset=20, width=192, height=160, do_rectify=True)
    of_sensor = np.array([120.0, 0, 135.5, 0, 122.0, 99.5, 0, 0, 1])
    write = change_info(width=300, height=200, K=of_sensor, binning_x=2, binning_y=2, roi=region)
    with BagWriter(path) as bag:
        write(bag)
        write_images(bag)
    recording = open_recording(path)
    assert recording.calibration.camera.parameters.tolist() == [60.0, 61.0, 47.5, 39.5]
    assert all(isinstance(frame, Frame) for frame in recording.frames())


def test_rectified_images(path):
    barrel = np.array([-0.1, 0.01, 0.0, 0.0, 0.0])
    P = np.array([55.0, 0, 45.0, 0, 0, 56.0, 41.0, 0, 0, 0, 1, 0])
    with BagWriter(path) as bag:
        change_info(D=barrel, P=P)(bag)
        write_images(bag, topic="/camera/up/image_rect")
    topics = TopicNames(image="/camera/up/image_rect")
    doubted, warnings = open_noisily(path, topics=topics)
    assert doubted.calibration.lens.distortion == tuple(barrel)
    assert len(warnings) == 1
    assert "/camera/up/image_rect: by its name these images are rectified" in warnings[0]
    recording, warnings = open_noisily(path, topics=topics, rectified=True)
    assert recording.calibration.keeps_images
    assert recording.calibration.camera.parameters.tolist() == [55.0, 56.0, 45.0, 41.0]
    assert warnings == []


def test_a_calibration_that_comes_late_is_waited_for(path):
    with BagWriter(path) as bag:
        for index in range(3):
            change_info(K=np.zeros(9))(bag, index)
        write_info(bag)
        write_images(bag)
    recording, warnings = open_noisily(path)
    assert recording.calibration.camera.fx == 60.0
    assert warnings == [
        f"{path}, {INFO}: the focal lengths fx=0 fy=0 must be positive; is the camera calibrated?; "
        "a later camera_info is used"
    ]
    assert len(list(recording.frames())) == 4
    assert len(warnings) == 1


def test_a_calibration_that_changes_is_warned_of(path):
    with BagWriter(path) as bag:
        for index in range(4):
            write_info(bag, K=K if index < 2 else K + np.diag([1.0, 0.0, 0.0]))
            write_images(bag, [index])
    recording, warnings = open_noisily(path)
    assert warnings == []
    assert len(list(recording.frames())) == 4
    assert len(warnings) == 1
    assert f"{path}, {INFO}: camera_info changes at 1700000001.030042017 to LensCamera(" in warnings[0]
    assert "fx=61.0" in warnings[0]


@pytest.mark.parametrize("form", ["folder", "camera file"])
def test_rectified_is_about_a_camera_info(path, tmp_path, form):
    with BagWriter(path) as bag:
        write_info(bag)
        write_images(bag)
    options = {"camera_file": tmp_path / "camera.txt"} if form == "camera file" else {}
    with pytest.raises(InputError, match="'rectified' means P of camera_info"):
        open_recording(tmp_path if form == "folder" else path, rectified=True, **options)
