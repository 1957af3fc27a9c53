# SPDX-License-Identifier: BSD-3-Clause
"""Exposure times of Intel's driver, without its package."""

import struct
from io import BytesIO
from types import SimpleNamespace

import pytest

pytest.importorskip("ceiling_dso_ros.msg", reason="needs ROS and the built workspace")
pytestmark = pytest.mark.ros

from rosless import Rosless  # noqa: E402
from std_msgs.msg import Header  # noqa: E402

from ceiling_dso_ros.msg import Exposure  # noqa: E402
from ceiling_dso_ros.ros.conversions import ros_time  # noqa: E402
from ceiling_dso_ros.ros.exposure_input import METADATA_TYPE, ExposureInput, stamped_text  # noqa: E402

STAMP_NS = 1_700_000_001_030_042_017
TEXT = '{"frame_number":7,"clock_domain":"global_time","actual_exposure":8015,"gain_level":16}'


def serialised(text, stamp_ns=STAMP_NS):
    buffer = BytesIO()
    Header(seq=7, stamp=ros_time(stamp_ns), frame_id="camera_infra1_optical_frame").serialize(buffer)
    data = text.encode()
    return buffer.getvalue() + struct.pack("<I", len(data)) + data


def metadata(data, kind=METADATA_TYPE):
    return SimpleNamespace(_buff=data, _connection_header={"type": kind})


@pytest.fixture
def world(monkeypatch):
    world = Rosless(monkeypatch)
    monkeypatch.setattr("rospy.logwarn_once", world.logged.append)
    yield world
    world.end()


def test_a_stamp_and_a_text():
    assert stamped_text(serialised(TEXT)) == (STAMP_NS, TEXT)


def test_exposures_of_the_drivers_metadata(world):
    exposures = ExposureInput()
    world.listened.add("metadata")
    world.callbacks["metadata"](metadata(serialised(TEXT)))
    assert exposures.at(STAMP_NS) == pytest.approx(8.015)
    assert exposures.complaint == ""


@pytest.mark.parametrize(
    "text", ["{}", "[]", "no json", '{"actual_exposure": "8"}', '{"actual_exposure": -1}', "[" * 9999]
)
def test_metadata_without_an_exposure_are_not_waited_for(world, text):
    exposures = ExposureInput()
    world.listened.add("metadata")
    world.callbacks["metadata"](metadata(serialised(text)))
    assert exposures.at(STAMP_NS) is None


@pytest.mark.parametrize("data", [b"", b"\x00" * 12, serialised(TEXT)[:30], serialised("")[:-1] + b"\xff"])
def test_damaged_metadata_do_no_harm(world, data):
    ExposureInput()
    world.callbacks["metadata"](metadata(data))


def test_another_type_of_message_is_named(world):
    ExposureInput()
    world.callbacks["metadata"](metadata(serialised(TEXT), "std_msgs/String"))
    assert world.logged == [f"/metadata is not used: it holds std_msgs/String, no {METADATA_TYPE}"]


def test_exposures_of_this_package(world):
    exposures = ExposureInput()
    world.listened.add("exposure")
    world.callbacks["exposure"](Exposure(Header(stamp=ros_time(STAMP_NS)), 5.0))
    assert exposures.at(STAMP_NS) == 5.0


def test_silent_publishers_are_stated(world):
    exposures = ExposureInput()
    world.listened.update(("exposure", "metadata"))
    for number in range(10):
        exposures.at(STAMP_NS + number)
    assert exposures.complaint == "/exposure and /metadata come too late or not at all: images do not wait for them"
