# SPDX-License-Identifier: BSD-3-Clause
import time

import pytest

from ceiling_dso_ros.drivers.image_times import (
    COUNTER_US,
    FrameTimes,
    StampSource,
    before_readout,
    host_time,
)


@pytest.mark.parametrize(
    ("times", "expected"),
    [
        (FrameTimes(1.0, True, 1000, 700, 8000), (300, StampSource.MIDDLE)),
        (FrameTimes(1.0, True, 100, COUNTER_US - 200, 8000), (300, StampSource.MIDDLE)),  # wrapped in between
        (FrameTimes(1.0, True, 700, 1000, 8000), (4000, StampSource.HALF)),  # the middle cannot be later
        (FrameTimes(1.0, True, None, 700, 8000), (4000, StampSource.HALF)),
        (FrameTimes(1.0, True, 1000, None, None), (0, StampSource.READOUT)),
        (FrameTimes(1.0, True, None, None, 0), (0, StampSource.READOUT)),
        (FrameTimes(1.0, False, 1000, 700, 8000), (4000, StampSource.ARRIVAL)),
        (FrameTimes(1.0, False), (0, StampSource.ARRIVAL)),
    ],
)
def test_from_the_readout_back_to_the_middle_of_the_exposure(times, expected):
    assert before_readout(times) == expected


@pytest.mark.parametrize(
    ("exposure_us", "exposure_ms"), [(8000, 8.0), (None, None), (0, None), (10**9, None), (-1, None)]
)
def test_exposures_that_can_be_right(exposure_us, exposure_ms):
    assert FrameTimes(1.0, True, exposure_us=exposure_us).exposure_ms == exposure_ms


def test_both_clocks_are_read_at_one_moment():
    before_ns, now, after_ns = time.time_ns(), host_time(), time.time_ns()
    assert before_ns - 1_000_000 <= now.raw_ns + now.ahead_ns <= after_ns + 1_000_000
