# SPDX-License-Identifier: BSD-3-Clause
"""Recordings as realsense-viewer makes them; test/drivers/test_recordings.py has some of the library itself."""

from types import SimpleNamespace

import numpy as np
import pytest

from ceiling_dso_ros.io.bag_writer import BagWriter
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.opening import open_recording
from ceiling_dso_ros.io.recording import TopicNames
from ceiling_dso_ros.io.ros_messages import header, message

STREAM = "/device_0/sensor_0/Infrared_1"
WIDTH, HEIGHT, FOCAL_PX = 96, 80, 60.0
PERIOD_US, EXPOSURE_US = 33_333, 8000
COUNTER_US = 2**32


ALL = ("Actual Exposure", "Frame Timestamp", "Sensor Timestamp")


def write(
    path, count=5, start_us=1_000_000, domain="Hardware Clock", known=ALL, emitter=0.0, stream=STREAM, header_ns=None
):
    with BagWriter(path) as bag:
        option = f"{stream.rpartition('/')[0]}/option/Emitter_Enabled/value"
        bag.write(option, 1, message("std_msgs/Float32", data=emitter))
        K = np.array([[FOCAL_PX, 0.0, 47.5], [0.0, FOCAL_PX, 39.5], [0.0, 0.0, 1.0]])
        bag.camera_info(f"{stream}/info/camera_info", 1, "0", (WIDTH, HEIGHT), K, distortion_model="Brown Conrady")
        for number in range(count):
            readout_us = (start_us + number * PERIOD_US) % COUNTER_US
            recorded_ns = 1000 * number * PERIOD_US + 1
            stamp_ns = 1000 * readout_us if header_ns is None else header_ns(number)
            image = message(
                "sensor_msgs/Image", header=header(stamp_ns, "0", number), height=HEIGHT, width=WIDTH, encoding="8UC1",
                is_bigendian=0, step=WIDTH, data=np.full(WIDTH * HEIGHT, number, np.uint8),
            )  # fmt: skip
            bag.write(f"{stream}/image/data", recorded_ns, image)
            values = {
                "Frame Timestamp": readout_us,
                "Sensor Timestamp": (readout_us - EXPOSURE_US // 2 - 100) % COUNTER_US,
                "Actual Exposure": EXPOSURE_US + number,
                "Gain Level": 16,
            }
            entries = {name: value for name, value in values.items() if name in (*known, "Gain Level")}
            for key, value in {"timestamp_domain": domain, **entries}.items():
                entry = message("diagnostic_msgs/KeyValue", key=key, value=str(value))
                bag.write(f"{stream}/image/metadata", recorded_ns, entry)
    return path


@pytest.fixture
def path(tmp_path):
    return tmp_path / "viewer.bag"


def listed(path, **options):
    warnings = []
    recording = open_recording(path, warn=warnings.append, **options)
    images = list(recording.images())
    return SimpleNamespace(
        recording=recording,
        images=images,
        stamps_us=[image.stamp_ns / 1000 for image in images],
        exposures_ms=[image.exposure_ms for image in images],
        warnings=warnings,
    )


def test_images_stamps_and_exposures_as_they_were_recorded(path):
    found = listed(write(path))
    assert len(found.recording) == 5
    assert found.recording.calibration.lens.fx == FOCAL_PX
    assert found.exposures_ms == [8.0, 8.001, 8.002, 8.003, 8.004]
    assert found.stamps_us == [1_000_000 + number * PERIOD_US - 4100 for number in range(5)]
    assert [int(image.decode()[0, 0]) for image in found.images] == [0, 1, 2, 3, 4]
    assert found.warnings == []


def test_stamps_go_on_where_the_counter_wraps_around(path):
    found = listed(write(path, start_us=COUNTER_US - 2 * PERIOD_US))
    assert np.diff(found.stamps_us).tolist() == [PERIOD_US] * 4


@pytest.mark.parametrize(
    ("known", "before_us"),
    [
        (("Actual Exposure", "Frame Timestamp"), EXPOSURE_US / 2),
        (("Actual Exposure",), EXPOSURE_US / 2),
        (("Frame Timestamp", "Sensor Timestamp"), EXPOSURE_US / 2 + 100),
        ((), 0),
    ],
)
def test_metadata_may_be_missing(path, known, before_us):
    found = listed(write(path, known=known, start_us=COUNTER_US - 2 * PERIOD_US))
    assert found.stamps_us[0] == pytest.approx(COUNTER_US - 2 * PERIOD_US - before_us)
    assert np.diff(found.stamps_us) == pytest.approx([PERIOD_US] * 4, abs=2)
    has_exposures = "Actual Exposure" in known
    assert (found.exposures_ms != [None] * 5) == has_exposures
    assert [text for text in found.warnings if "has no exposure times" in text] == found.warnings
    assert len(found.warnings) == (not has_exposures)


def test_jumps_of_the_librarys_time_do_not_matter(path):
    """The library's global time goes back by half a second once."""
    start_ns = 1_700_000_000_000_000_000

    def header_ns(number):
        return start_ns + 1000 * number * PERIOD_US - (500_000_000 if number >= 3 else 0)

    found = listed(write(path, domain="Global Time", header_ns=header_ns))
    assert found.images[0].stamp_ns == start_ns - 4_100_000
    assert np.diff([image.stamp_ns for image in found.images]).tolist() == [1000 * PERIOD_US] * 4


def test_an_emitter_that_is_on_is_warned_of(path):
    assert listed(write(path, emitter=1.0)).warnings == [
        f"{path}: the emitter is on: its dots move with the robot; switch it off"
    ]


def test_another_stream_can_be_named(path):
    stream = "/device_0/sensor_0/Infrared_2"
    write(path, stream=stream)
    topics = TopicNames(image=f"{stream}/image/data")
    assert listed(path, topics=topics).exposures_ms[0] == 8.0
    with pytest.raises(
        InputError, match="is not in the bag; choose with --image-topic: it has /device_0/sensor_0/Infrared_2/image"
    ):
        open_recording(path)


def test_a_topic_that_was_named_is_not_replaced(path):
    write(path)
    with pytest.raises(InputError, match="topic /my/image is not in the bag"):
        open_recording(path, TopicNames(image="/my/image"))


def test_there_are_no_wheels(path):
    recording = open_recording(write(path))
    assert recording.wheels is None
    assert recording.image_times().delay_ns is None
