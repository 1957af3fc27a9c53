# SPDX-License-Identifier: BSD-3-Clause
import pytest

from ceiling_dso_ros.io.stamps import (
    format_stamp,
    longest_increasing,
    parse_stamp,
    parse_stamp_ns,
    parts_of_stamp,
    stamp_from_parts,
    stamps_in_ns,
)


@pytest.mark.parametrize(
    ("text", "stamp_ns"),
    [
        ("1305031102.175303936", 1_305_031_102_175_303_936),
        ("1305031102.1753039364", 1_305_031_102_175_303_936),
        ("1700001001.030042", 1_700_001_001_030_042_000),
        ("0", 0),
        ("12", 12_000_000_000),
        ("1.5e3", 1_500_000_000_000),
    ],
)
def test_decimal_seconds_become_exact_nanoseconds(text, stamp_ns):
    assert parse_stamp_ns(text) == stamp_ns


@pytest.mark.parametrize("text", ["nan", "inf", "-1.0", "abc", "", "1,5", "1e400000000", "9223372036854775808"])
def test_other_text_is_refused(text):
    with pytest.raises(ValueError):
        parse_stamp_ns(text)


def test_format_is_the_inverse_of_parse():
    for stamp_ns in (0, 1, 999_999_999, 1_000_000_000, 1_305_031_102_175_303_936):
        assert parse_stamp_ns(format_stamp(stamp_ns)) == stamp_ns


def test_a_stamp_that_no_int64_holds_is_refused():
    assert parse_stamp_ns("9223372036.854775807") == 2**63 - 1
    with pytest.raises(ValueError, match=r"9223372036\.854775808 is beyond the year 2262"):
        parse_stamp_ns("9223372036.854775808")


def test_ros_writes_a_stamp_in_two_parts():
    assert parts_of_stamp(1_732_800_000_123_456_789) == (1_732_800_000, 123_456_789)
    assert stamp_from_parts(1_732_800_000, 123_456_789) == 1_732_800_000_123_456_789


@pytest.mark.parametrize(
    ("texts", "stamps_ns"),
    [
        (["1700000000000000001", "1700000000000000002"], None),  # too near to each other
        (["1700000000000000000", "1700000000033333333"], [1_700_000_000_000_000_000, 1_700_000_000_033_333_333]),
        (["1.700000000000000000e+18", "1.700000000033333333e+18"], [17 * 10**17, 17 * 10**17 + 33_333_333]),
        (["1700000000.5", "1700000001000000000"], [1_700_000_000_500_000_000, 1_700_000_001_000_000_000]),
        (["0", "33333333", "66666666"], [0, 33_333_333, 66_666_666]),  # of a robot's clock, shorter than 9 s
        (["0", "33333333", "10000000000"], [0, 33_333_333, 10_000_000_000]),
        (["0.000000000", "33333333.000000000"], [0, 33_333_333 * 10**9]),
        (["1700000000", "1700000001", "1700000060"], [s * 10**9 for s in (1700000000, 1700000001, 1700000060)]),
        (["1700000000000000", "1700000000033333"], None),  # microseconds
        (["1700000000000000000"], [1_700_000_000_000_000_000]),
        ([], []),
    ],
)
def test_the_stamps_of_a_file_are_seconds_or_nanoseconds(texts, stamps_ns):
    numbers = [parse_stamp(text) for text in texts]
    if stamps_ns is None:
        with pytest.raises(ValueError, match="neither seconds nor nanoseconds"):
            stamps_in_ns(numbers)
    else:
        assert stamps_in_ns(numbers) == stamps_ns


@pytest.mark.parametrize(
    ("stamps", "kept"),
    [
        ([], []),
        ([7], [0]),
        ([1, 2, 3], [0, 1, 2]),
        ([1, 2, 2, 3], [0, 1, 3]),  # of equal ones the first
        ([1, 2, 99, 3, 4], [0, 1, 3, 4]),  # one that is far too late costs itself alone
        ([1, 2, 0, 3, 4], [0, 1, 3, 4]),
        ([5, 6, 7, 1, 2], [0, 1, 2]),  # the clock was set back: what is longer
        ([3, 3, 3], [0]),
        ([3, 2, 1], [2]),
    ],
)
def test_as_few_stamps_as_possible_are_left_out(stamps, kept):
    assert longest_increasing(stamps) == kept
