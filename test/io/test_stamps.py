import pytest

from ceiling_dso_ros.io.stamps import format_stamp, parse_stamp_ns, seconds


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


@pytest.mark.parametrize("text", ["nan", "inf", "-1.0", "abc", "", "1,5"])
def test_other_text_is_refused(text):
    with pytest.raises(ValueError):
        parse_stamp_ns(text)


def test_format_is_the_inverse_of_parse():
    for stamp_ns in (0, 1, 999_999_999, 1_000_000_000, 1_305_031_102_175_303_936):
        assert parse_stamp_ns(format_stamp(stamp_ns)) == stamp_ns


def test_seconds_are_the_nearest_float():
    for text in ("1305031102.175303936", "1700000001.100042017", "0.1", "3.000000001"):
        assert seconds(parse_stamp_ns(text)) == float(text)
