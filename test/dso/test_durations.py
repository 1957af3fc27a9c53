# SPDX-License-Identifier: BSD-3-Clause
from ceiling_dso_ros.dso.durations import LONG_AGO_NS, nanoseconds, seconds


def test_differences_of_epoch_stamps_are_the_floats_that_one_would_write():
    begin_ns = 1_732_800_000_123_456_789
    assert seconds(begin_ns + 20_000_000 - begin_ns) == 0.02
    assert seconds(begin_ns - (begin_ns + 100_000_000)) == -0.1


def test_offsets_become_the_nearest_nanosecond():
    assert nanoseconds(-0.0125) == -12_500_000
    assert nanoseconds(1.0 / 3.0) == 333_333_333


def test_long_ago_is_before_every_stamp_and_its_difference_fits():
    assert LONG_AGO_NS < 0
    assert seconds(1_732_800_000_123_456_789 - LONG_AGO_NS) > 1e9
