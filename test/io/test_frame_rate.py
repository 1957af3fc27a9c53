# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.frame_rate import SLOWEST_HZ, FrameRateLimit, parse_frame_rate, require_frame_rate

START_NS = 1_700_000_000 * 10**9


def stamps(frame_rate, count, jitter_s=0.0):
    """int nanoseconds of a camera's images."""
    jitter = np.random.default_rng(0).uniform(-jitter_s, jitter_s, count)
    return [START_NS + round(1e9 * (number / frame_rate + late)) for number, late in enumerate(jitter)]


def passed(limit, given):
    return [stamp_ns for stamp_ns in given if limit.passes(stamp_ns)]


def test_without_a_rate_all_pass():
    given = [*stamps(30.0, 10), START_NS, START_NS]
    assert passed(FrameRateLimit(), given) == given


@pytest.mark.parametrize("jitter_s", [0.0, 0.004])
@pytest.mark.parametrize("frame_rate", [3.0, 10.0, 15.0, 20.0, 25.0])
def test_the_mean_rate_is_kept_whether_or_not_the_cameras_is_a_multiple(frame_rate, jitter_s):
    left = passed(FrameRateLimit(frame_rate), stamps(30.0, 301, jitter_s))
    assert len(left) == pytest.approx(10.0 * frame_rate, abs=1.0 + 0.02 * frame_rate)
    longest_s = 1e-9 * np.diff(left).max()
    assert longest_s < 1.0 / frame_rate + 1.0 / 30.0 + 2.0 * jitter_s


@pytest.mark.parametrize("frame_rate", [30.0, 31.0, 60.0])
def test_a_camera_that_is_no_faster_loses_nothing(frame_rate):
    given = stamps(30.0, 300, jitter_s=0.003)
    assert passed(FrameRateLimit(frame_rate), given) == given


def test_every_third_of_a_steady_camera():
    given = stamps(30.0, 90, jitter_s=0.002)
    assert passed(FrameRateLimit(10.0), given) == given[::3]


def test_the_first_image_after_a_gap_and_after_time_has_gone_back_passes():
    limit = FrameRateLimit(10.0)
    given = stamps(30.0, 10)
    passed(limit, given)
    later_ns = given[-1] + 750_000_000
    assert passed(limit, [later_ns, later_ns + 50_000_000, later_ns + 100_000_000]) == [
        later_ns,
        later_ns + 100_000_000,
    ]
    assert passed(limit, given) == given[::3]


def test_an_image_out_of_order_does_not_start_the_clock_again():
    limit = FrameRateLimit(10.0)
    given = stamps(30.0, 31)
    disordered = [*given[:4], given[3] - 1_000_000, *given[4:]]
    assert passed(limit, disordered) == given[::3]


def test_the_rate_may_be_changed():
    limit = FrameRateLimit(10.0)
    given = stamps(30.0, 60)
    assert passed(limit, given[:30]) == given[:30:3]
    limit.frame_rate = 0.0
    assert passed(limit, given[30:40]) == given[30:40]
    limit.frame_rate = 15.0
    assert len(passed(limit, given[40:])) == pytest.approx(10, abs=1)


@pytest.mark.parametrize("frame_rate", [-1.0, 5e-324, 1e-300, 1e-9, 0.99 * SLOWEST_HZ, float("inf"), float("nan")])
def test_rates_that_make_no_sense_are_refused(frame_rate):
    with pytest.raises(InputError, match=rf"^frame_rate={frame_rate:g}: 0 for all images, or .* or more a second$"):
        require_frame_rate(frame_rate, "frame_rate=")


@pytest.mark.parametrize("frame_rate", [SLOWEST_HZ, 1e300])
def test_the_slowest_and_the_fastest_rate_select_images(frame_rate):
    require_frame_rate(frame_rate, "frame_rate=")
    given = stamps(30.0, 30)
    assert passed(FrameRateLimit(frame_rate), given) == (given[:1] if frame_rate < 1.0 else given)


@pytest.mark.parametrize(
    ("text", "frame_rate"), [("15", 15.0), ("0", 0.0), ("0.0", 0.0), ("1e1", 10.0), ("auto", None)]
)
def test_a_rate_is_a_number_or_auto(text, frame_rate):
    assert parse_frame_rate(text, "frame_rate=") == frame_rate


@pytest.mark.parametrize("text", ["", "automatic", "15 Hz", "-1", "nan", "inf", "1e-300"])
def test_other_texts_are_no_rate(text):
    with pytest.raises(InputError, match=rf"^frame_rate={text}: .*0 for all images, or "):
        parse_frame_rate(text, "frame_rate=")
