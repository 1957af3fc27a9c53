# SPDX-License-Identifier: BSD-3-Clause
import shutil

import numpy as np
import pytest
from small_bag import (
    HEIGHT,
    IMAGE,
    INFO,
    PERIOD_NS,
    WIDTH,
    K,
    picture,
    stamp_ns,
    write_damaged,
    write_images,
    write_info,
)

from ceiling_dso_ros.io.bag_writer import BagWriter
from ceiling_dso_ros.io.errors import FrameError, InputError
from ceiling_dso_ros.io.opening import open_recording
from ceiling_dso_ros.io.recording import TopicNames
from ceiling_dso_ros.io.recording_view import RecordingPart

RIGHT, RIGHT_INFO = "/camera/up_right/image_raw", "/camera/up_right/camera_info"
BASELINE = {"baseline_m": 0.095}
LEFT_FRAME, RIGHT_FRAME = "left", "right"


def right_picture(index):
    return 255 - picture(index)


def pose(x, angle=0.0):
    T = np.eye(4)
    T[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    T[0, 3] = x
    return T


@pytest.fixture
def make(tmp_path):
    """Writes a bag with two cameras; returns the recording, and what was warned of."""

    def write(rights=range(4), transform=None, info=BASELINE, jitter_ns=0, extra=None, **topics):
        path, warnings = tmp_path / "tour.bag", []
        with BagWriter(path) as bag:
            write_info(bag)
            if info is not None:
                bag.camera_info(RIGHT_INFO, stamp_ns(0), RIGHT_FRAME, (WIDTH, HEIGHT), K, **info)
            if transform is not None:
                bag.tf_static(stamp_ns(0), [("base", LEFT_FRAME, pose(0.2)), (LEFT_FRAME, RIGHT_FRAME, transform)])
            for index in range(4):
                bag.image(IMAGE, stamp_ns(index), LEFT_FRAME, picture(index))
                if index in rights:
                    bag.image(RIGHT, stamp_ns(index) + jitter_ns, RIGHT_FRAME, right_picture(index))
            if extra is not None:
                extra(bag)
        return open_recording(path, TopicNames(**topics), warn=warnings.append), warnings

    return write


def test_images_of_one_moment_are_pairs(make):
    recording, warnings = make(rights=(0, 2, 3))
    frames = list(recording.frames())
    assert [frame.right is not None for frame in frames] == [True, False, True, True]
    for index in (0, 2, 3):
        np.testing.assert_array_equal(frames[index].image, picture(index))
        np.testing.assert_array_equal(frames[index].right(), right_picture(index))
    assert warnings == []
    assert len(recording) == 4


def test_stamps_may_differ_by_less_than_an_exposure(make):
    assert all(frame.right is not None for frame in make(jitter_ns=900_000)[0].frames())
    assert not any(frame.right is not None for frame in make(jitter_ns=PERIOD_NS // 2)[0].frames())


def test_a_part_of_a_recording_has_its_own_pairs(make):
    recording, _ = make()
    part = RecordingPart(recording, start_s=1.5 * PERIOD_NS * 1e-9)
    (first, *_) = part.frames()
    np.testing.assert_array_equal(first.right(), right_picture(2))
    assert part.second_camera is recording.second_camera


def test_tf_says_where_the_second_camera_is(make):
    camera = make(transform=pose(0.05, 0.01))[0].second_camera
    np.testing.assert_allclose(camera.T_left_right, pose(0.05, 0.01), atol=1e-9)
    assert camera.calibration.camera.parameters.tolist() == [60.0, 61.0, 47.5, 39.5]


def test_else_camera_info_of_a_rectified_pair_says_it(make):
    np.testing.assert_allclose(make()[0].second_camera.T_left_right, pose(0.095))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"info": {}}, "neither tf nor P says where the second camera is"),
        ({"info": None}, "no camera_info on /camera/up_right/camera_info"),
        ({"info": {"baseline_m": np.nan}}, "neither tf nor P"),
        ({"right_image": "/elsewhere"}, "there are no images on /elsewhere"),
    ],
)
def test_without_its_geometry_a_second_camera_is_not_used(make, changes, said):
    recording, warnings = make(**changes)
    assert recording.second_camera is None
    assert all(frame.right is None for frame in recording.frames())
    assert len(warnings) == 1
    assert said in warnings[0]


def test_a_second_camera_can_be_left_out(make):
    recording, warnings = make(right_image="")
    assert recording.second_camera is None
    assert warnings == []
    assert all(frame.right is None for frame in recording.frames())


def test_a_damaged_right_image_costs_no_left_one(make):
    recording, _ = make(rights=(0, 3), extra=lambda bag: write_damaged(bag, RIGHT, "sensor_msgs/Image"))
    frames = list(recording.frames())
    assert len(frames) == 4
    np.testing.assert_array_equal(frames[3].right(), right_picture(3))


def test_a_clock_that_was_set_back_does_not_end_the_pairs(tmp_path):
    path = tmp_path / "tour.bag"
    with BagWriter(path) as bag:
        write_info(bag)
        bag.camera_info(RIGHT_INFO, stamp_ns(0), RIGHT_FRAME, (WIDTH, HEIGHT), K, **BASELINE)
        for index in (100, 101, 0, 1):  # the writer takes stamps for the times of writing
            for topic, image in ((IMAGE, picture(index)), (RIGHT, right_picture(index))):
                bag.image(topic, stamp_ns(index), LEFT_FRAME, image)
    rights = {listed.stamp_ns: listed.right for listed in open_recording(path).images()}
    for index in (0, 1, 100, 101):
        np.testing.assert_array_equal(rights[stamp_ns(index)](), right_picture(index))


def test_one_camera_is_no_pair(tmp_path):
    with BagWriter(tmp_path / "tour.bag") as bag:
        write_info(bag, INFO)
        write_images(bag)
    recording = open_recording(tmp_path / "tour.bag")
    assert recording.second_camera is None
    assert all(frame.right is None for frame in recording.frames())


RIG = "T_left_right: {xyz: [0.095, 0.0, 0.0], quat_xyzw: [0.0, 0.0, 0.0, 1.0]}\n"


@pytest.fixture
def stereo_folder(tum_folder):
    """Right images are the left ones in reversed order."""
    shutil.copy(tum_folder / "camera.txt", tum_folder / "camera_right.txt")
    (tum_folder / "rig.yaml").write_text(RIG)
    (tum_folder / "images_right").mkdir()
    names = sorted(path.name for path in (tum_folder / "images").iterdir())
    for name, other in zip(names, reversed(names)):
        shutil.copy(tum_folder / "images" / other, tum_folder / "images_right" / name)
    return tum_folder


def test_a_folder_of_two_cameras(stereo_folder):
    recording = open_recording(stereo_folder)
    np.testing.assert_allclose(recording.second_camera.T_left_right, pose(0.095))
    frames = list(recording.frames())
    for frame, other in zip(frames, reversed(frames)):
        np.testing.assert_array_equal(frame.right(), other.image)


def test_a_folder_without_a_right_image(stereo_folder):
    sorted((stereo_folder / "images_right").iterdir())[2].unlink()
    assert [frame.right is None for frame in open_recording(stereo_folder).frames()].index(True) == 2


def test_a_right_image_that_cannot_be_read_is_told_when_it_is_asked_for(stereo_folder):
    sorted((stereo_folder / "images_right").iterdir())[0].write_bytes(b"no image")
    (first, *_) = open_recording(stereo_folder).frames()
    with pytest.raises(FrameError):
        first.right()


@pytest.mark.parametrize(
    ("rig", "said"),
    [
        ("", "T_left_right must have xyz"),
        ("T_left_right: {xyz: [0, 0, 0], quat_xyzw: [0, 0, 0, 1]}", "is where the first one is"),
        ("baseline: 0.095", "baseline"),
    ],
)
def test_a_folder_whose_cameras_have_no_poses(stereo_folder, rig, said):
    (stereo_folder / "rig.yaml").write_text(rig)
    with pytest.raises(InputError, match=said):
        _ = open_recording(stereo_folder).second_camera


def test_a_folder_without_the_right_images(stereo_folder):
    shutil.rmtree(stereo_folder / "images_right")
    with pytest.raises(InputError, match="images_right"):
        open_recording(stereo_folder)
