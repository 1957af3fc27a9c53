# SPDX-License-Identifier: BSD-3-Clause
import os
import re

import numpy as np
import pytest

from ceiling_dso_ros.io.camera_info import calibration_from_camera_info
from ceiling_dso_ros.io.errors import FrameError, InputError
from ceiling_dso_ros.io.opening import open_recording
from ceiling_dso_ros.io.recording import Frame, ListedImage, Recording, SkippedFrame, TopicNames


class Listed(Recording):
    """A recording of images given as (stamp_ns, image or error)."""

    calibration = calibration_from_camera_info(96, 80, "", [], [60, 0, 47.5, 0, 61, 39.5, 0, 0, 1])
    wheels = robot = ground_truth_path = None

    def __init__(self, *images):
        self._images = images

    def __len__(self):
        return len(self._images)

    def images(self):
        def decode(content):
            if isinstance(content, FrameError):
                raise content
            return content

        for number, (stamp_ns, content) in enumerate(self._images):
            yield ListedImage(stamp_ns, None, f"image {number}", lambda content=content: decode(content))


GOOD = np.zeros((80, 96), np.uint8)


def test_bad_frames_are_replaced_and_the_rest_goes_on():
    recording = Listed(
        (1_000_000_000, GOOD),
        (2_000_000_000, FrameError("truncated image")),
        (None, FrameError("damaged message")),
        (3_000_000_000, np.zeros((40, 48), np.uint8)),
        (4_000_000_000, GOOD),
        (4_000_000_000, GOOD),
        (3_500_000_000, GOOD),
        (None, GOOD),
        (5_000_000_000, GOOD),
    )
    frames = list(recording.frames())
    assert [frame.stamp_ns for frame in frames if isinstance(frame, Frame)] == [10**9, 4 * 10**9, 5 * 10**9]
    assert [frame.reason for frame in frames if isinstance(frame, SkippedFrame)] == [
        "image 1: truncated image; frame skipped",
        "image 2: damaged message; frame skipped",
        "image 3: the image is 48x40, but the calibration is for 96x80; frame skipped",
        "image 5: the stamp 4.000000000 repeats that of the last frame; frame skipped",
        "image 6: the stamp 3.500000000 lies before that of the last frame; frame skipped",
        "image 7: it has no time stamp; frame skipped",
    ]


def test_a_skipped_frame_does_not_hold_back_those_after_it():
    recording = Listed((9_000_000_000, FrameError("truncated image")), (2_000_000_000, GOOD))
    assert isinstance(list(recording.frames())[1], Frame)


def test_frames_and_skipped_frames_carry_the_very_stamps():
    stamps_ns = (1_732_800_000_123_456_789, 1_732_800_000_123_456_790)
    recording = Listed((stamps_ns[0], GOOD), (stamps_ns[1], FrameError("truncated image")))
    assert tuple(frame.stamp_ns for frame in recording.frames()) == stamps_ns


def test_topics_beside_the_image():
    assert TopicNames().beside_image("camera_info") == "/camera/up/camera_info"
    assert TopicNames(image="/cam/image_raw/compressed").beside_image("camera_info") == "/cam/camera_info"


def test_a_pipe_is_refused_before_it_blocks(tmp_path):
    os.mkfifo(tmp_path / "pipe.bag")
    with pytest.raises(InputError, match="neither a folder nor a file"):
        open_recording(tmp_path / "pipe.bag")


def test_a_path_that_is_not_there(tmp_path):
    with pytest.raises(InputError, match=re.escape(f"{tmp_path / 'none'}: there is no such folder or bag")):
        open_recording(tmp_path / "none")


def test_a_frame_rate_thins_the_images_before_they_are_read():
    images = [(number * 100_000_000, FrameError("read for nothing")) for number in range(1, 31)]
    images[::5] = [(stamp_ns, GOOD) for stamp_ns, _ in images[::5]]
    frames = list(Listed(*images).frames(frame_rate=2.0))
    assert [type(frame) for frame in frames] == [Frame] * 6
    assert len(list(Listed(*images).frames())) == 30


def test_an_image_that_is_left_out_is_not_read_and_asked_about_after_those_before_it():
    asked_ns, used_ns = [], []

    def leaves_out(stamp_ns):
        asked_ns.append(stamp_ns)
        assert used_ns == asked_ns[: len(used_ns)]
        return len(used_ns) == 3

    images = [(k * 10**8, GOOD if k <= 3 else FrameError("read for nothing")) for k in range(1, 10)]
    for frame in Listed(*images).frames(leaves_out=leaves_out):
        assert isinstance(frame, Frame)
        used_ns.append(frame.stamp_ns)
    assert used_ns == [10**8, 2 * 10**8, 3 * 10**8]
    assert len(asked_ns) == 9
