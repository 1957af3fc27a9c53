# SPDX-License-Identifier: BSD-3-Clause
"""Stamps of whole images: their order, what is left out and counted."""

import numpy as np
import pytest

from ceiling_dso_ros.drivers.image_times import COUNTER_US, FrameTimes, HostTime, StampSource
from ceiling_dso_ros.drivers.reports import CapturedImages
from ceiling_dso_ros.drivers.stamping import ImageStamper

IMAGES = (np.zeros((2, 2), np.uint8),)
AHEAD_NS = 1_700_000_000_000_000_000  # the time of day when the computer was switched on
PERIOD_US = 33_333
EXPOSURE_US = 8000


def captured(number, counter_us=None, ahead_ns=AHEAD_NS, delay_us=2000, exposure_us=EXPOSURE_US, of_device=True):
    taken_us = number * PERIOD_US
    counter_us = taken_us % COUNTER_US if counter_us is None else counter_us
    middle_us = (counter_us - EXPOSURE_US // 2) % COUNTER_US
    arrival = HostTime(1000 * (taken_us + delay_us), ahead_ns)
    timestamp_ms = 1e-3 * counter_us if of_device else 1e-6 * (ahead_ns + arrival.raw_ns)
    return CapturedImages(
        IMAGES, FrameTimes(timestamp_ms, of_device, counter_us, middle_us, exposure_us), number, arrival, 16
    )


def stamps(stamper, reports):
    return [stamped.stamp_ns for stamped in map(stamper.stamp, reports) if stamped is not None]


def test_images_are_stamped_in_the_middle_of_the_exposure_by_the_time_of_day():
    stamper = ImageStamper()
    found = stamps(stamper, map(captured, range(100)))
    expected = [AHEAD_NS + 1000 * (number * PERIOD_US + 2000 - EXPOSURE_US // 2) for number in range(100)]
    assert found == expected[-len(found) :]
    assert stamper.source is StampSource.MIDDLE
    assert stamper.stamp(captured(100)).exposure_ms == 8.0


def test_images_of_the_first_second_are_left_out():
    assert 69 <= len(stamps(ImageStamper(), map(captured, range(100)))) <= 70


def test_missing_images_are_counted():
    stamper = ImageStamper()
    stamps(stamper, [captured(number) for number in range(100) if number not in (40, 50, 51)])
    assert stamper.dropped == 3


def test_another_connection_counts_anew():
    stamper = ImageStamper()
    stamps(stamper, map(captured, range(1000, 1100)))
    stamper.connected()
    later = [
        captured(number, (number - 1200) * PERIOD_US)._replace(number=number - 1200) for number in range(1200, 1300)
    ]
    found = stamps(stamper, later)
    assert stamper.dropped == stamper.refused == 0
    assert found[-1] == AHEAD_NS + 1000 * (1299 * PERIOD_US + 2000 - EXPOSURE_US // 2)


def test_stamps_follow_a_computer_whose_clock_is_set():
    stamper = ImageStamper()
    before = stamps(stamper, map(captured, range(100)))
    hour_ns = 3600 * 10**9
    after = stamps(stamper, (captured(number, ahead_ns=AHEAD_NS - hour_ns) for number in range(100, 200)))
    assert len(after) == 100
    assert after[0] - before[-1] == 1000 * PERIOD_US - hour_ns


def test_stamps_grow_when_the_clock_is_set_a_little():
    stamper = ImageStamper()
    reports = [captured(number, ahead_ns=AHEAD_NS - (0 if number < 100 else 90_000_000)) for number in range(200)]
    found = stamps(stamper, reports)
    assert (np.diff(found) > 0).all()
    assert stamper.refused == 2  # of 90 ms


@pytest.mark.parametrize("exposure_us", [None, EXPOSURE_US])
def test_without_the_cameras_clock_the_arrival_counts(exposure_us):
    stamper = ImageStamper()
    found = stamper.stamp(captured(0, exposure_us=exposure_us, of_device=False))
    half_ns = 0 if exposure_us is None else 500 * exposure_us
    assert abs(found.stamp_ns - (AHEAD_NS + 2_000_000 - half_ns)) < 1000  # milliseconds as floats
    assert stamper.source is StampSource.ARRIVAL
    assert found.exposure_ms == (None if exposure_us is None else 8.0)
