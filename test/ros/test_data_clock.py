# SPDX-License-Identifier: BSD-3-Clause
import pytest

from ceiling_dso_ros.ros.data_clock import BACKWARDS_NS, FOLLOWERS, DataClock, StampKind

START_NS = 1_732_800_000_123_456_789
STEP_NS = 20_000_000


def clock_after(*stamps_ns):
    clock = DataClock()
    assert [clock.take(stamp_ns) for stamp_ns in stamps_ns] == [StampKind.NEXT] * len(stamps_ns)
    return clock


@pytest.mark.parametrize(
    ("ahead_ns", "kind"),
    [
        (1, StampKind.NEXT),
        (3600 * 10**9, StampKind.NEXT),
        (0, StampKind.REPEATED),
        (-1, StampKind.LATE),
        (-BACKWARDS_NS, StampKind.LATE),
        (-BACKWARDS_NS - 1, StampKind.BACK),
    ],
)
def test_kinds_of_stamps(ahead_ns, kind):
    assert clock_after(START_NS - STEP_NS, START_NS).take(START_NS + ahead_ns) is kind


@pytest.mark.parametrize("back_ns", [0, 1, BACKWARDS_NS, 10 * BACKWARDS_NS])
def test_what_is_not_next_changes_nothing(back_ns):
    clock = clock_after(START_NS)
    clock.take(START_NS - back_ns)
    assert clock.last_ns == START_NS
    assert clock.take(START_NS + 1) is StampKind.NEXT


def test_while_the_clock_is_not_set_back_its_stamps_are_used_as_they_are():
    clock = clock_after(START_NS, START_NS + STEP_NS)
    for stamp_ns in (0, START_NS - 10**12, START_NS + 7, START_NS + 10**12):
        assert clock.inner_ns(stamp_ns) == clock.stamp_ns(stamp_ns) == stamp_ns


@pytest.mark.parametrize("back_ns", [BACKWARDS_NS + STEP_NS + 1, 10**9, 3600 * 10**9])
def test_time_goes_on_by_the_last_interval_when_the_clock_is_set_back(back_ns):
    clock = clock_after(START_NS, START_NS + STEP_NS)
    stamps_ns = [START_NS + (2 + k) * STEP_NS - back_ns for k in range(3)]
    assert clock.take(stamps_ns[0]) is StampKind.BACK
    assert clock.behind_s(stamps_ns[0]) == pytest.approx(back_ns * 1e-9 - 0.02)
    clock.set_back(stamps_ns[0])
    assert [clock.take(stamp_ns) for stamp_ns in stamps_ns[1:]] == [StampKind.NEXT] * 2
    inner_ns = [clock.inner_ns(stamp_ns) for stamp_ns in stamps_ns]
    assert inner_ns == [START_NS + (2 + k) * STEP_NS for k in range(3)]
    assert [clock.stamp_ns(time_ns) for time_ns in inner_ns] == stamps_ns


def test_a_stamp_of_before_keeps_its_time_and_is_found_again():
    clock = clock_after(START_NS, START_NS + STEP_NS)
    clock.set_back(START_NS + 2 * STEP_NS - 10**9)
    image_ns = START_NS - 15_000_000  # another stream's, which arrives late
    assert clock.inner_ns(image_ns) == image_ns
    assert clock.stamp_ns(image_ns) == image_ns


def test_a_clock_that_is_set_back_again_and_again():
    clock, stamp_ns, time_ns = clock_after(START_NS, START_NS + STEP_NS), START_NS + STEP_NS, START_NS + STEP_NS
    for _ in range(5):
        stamp_ns -= 10**9
        assert clock.take(stamp_ns) is StampKind.BACK
        clock.set_back(stamp_ns)
        time_ns += STEP_NS
        assert (clock.inner_ns(stamp_ns), clock.last_ns) == (time_ns, time_ns)
        assert clock.stamp_ns(time_ns) == stamp_ns


def test_after_a_reset_any_stamp_is_the_next():
    clock = clock_after(START_NS, START_NS + STEP_NS)
    clock.set_back(START_NS - 10**9)
    clock.reset()
    assert clock.take(5) is StampKind.NEXT
    assert clock.inner_ns(5) == 5


def test_there_is_nothing_to_set_back_before_the_first_stamp():
    clock = DataClock()
    clock.set_back(5)
    assert clock.last_ns is None
    assert clock.inner_ns(7) == 7


def test_a_clock_that_is_set_back_for_ever_does_not_fill_the_memory(monkeypatch):
    monkeypatch.setattr("ceiling_dso_ros.ros.data_clock.MOST_ERAS", 3)
    clock = clock_after(START_NS - STEP_NS, START_NS)
    for number in range(1, 10):
        stamp_ns = START_NS - number * 10**9
        assert clock.take(stamp_ns) is StampKind.BACK
        clock.set_back(stamp_ns)
        assert clock.stamp_ns(clock.inner_ns(stamp_ns)) == stamp_ns
    assert len(clock._eras) == 3


def test_stamps_that_are_wrong_by_a_century_do_not_add_up():
    """Trajectories have the inner stamps, as int64: the third such stamp was beyond."""
    clock = clock_after(START_NS, START_NS + STEP_NS)
    wrong_ns = (2**32 - 1) * 10**9
    for k in range(2, 100):
        stamp_ns = START_NS + k * STEP_NS
        assert clock.take(wrong_ns) is StampKind.NEXT
        assert clock.stamp_ns(clock.last_ns) == wrong_ns
        assert clock.take(stamp_ns) is StampKind.BACK
        clock.set_back(stamp_ns)
        assert clock.stamp_ns(clock.last_ns) == stamp_ns
        assert clock.inner_ns(stamp_ns) == clock.last_ns == START_NS + (2 * k - 1) * STEP_NS


@pytest.mark.parametrize("back_ns", [210_000_000, 300_000_000, BACKWARDS_NS])
def test_a_clock_that_is_set_back_by_little_is_known_by_the_stamps_that_follow(back_ns):
    clock = clock_after(START_NS, START_NS + STEP_NS)
    stamps_ns = [START_NS + (2 + k) * STEP_NS - back_ns for k in range(6)]
    assert [clock.take(stamp_ns) for stamp_ns in stamps_ns[:4]] == [StampKind.LATE] * FOLLOWERS + [StampKind.BACK]
    clock.set_back(stamps_ns[3])
    assert [clock.take(stamp_ns) for stamp_ns in stamps_ns[4:]] == [StampKind.NEXT] * 2
    assert [clock.inner_ns(stamp_ns) for stamp_ns in stamps_ns[3:]] == [START_NS + (5 + k) * STEP_NS for k in range(3)]


def test_samples_that_change_places_are_late_and_no_clock():
    clock = clock_after(START_NS, START_NS + 5 * STEP_NS)
    late_ns = [START_NS + k * STEP_NS for k in range(1, 5)]
    assert [clock.take(stamp_ns) for stamp_ns in late_ns] == [StampKind.LATE] * 4
    assert clock.take(START_NS + 6 * STEP_NS) is StampKind.NEXT


@pytest.mark.parametrize("back_ns", [45_000_000, 100_000_000, 150_000_000, 200_000_000])
def test_a_clock_that_is_set_back_by_less_is_known_by_stamps_that_come_in_time(back_ns):
    """ntpd sets a clock that is wrong by 128 ms or more."""
    clock, arrivals_ns = DataClock(), [k * STEP_NS for k in range(6)]
    stamps_ns = [START_NS + at_ns - (back_ns if k >= 2 else 0) for k, at_ns in enumerate(arrivals_ns)]
    kinds = [clock.take(*each) for each in zip(stamps_ns[:4], arrivals_ns)]
    assert kinds == [StampKind.NEXT, StampKind.NEXT, StampKind.LATE, StampKind.BACK]
    clock.set_back(stamps_ns[3], elapsed_ns=2 * STEP_NS)
    assert [clock.take(*each) for each in zip(stamps_ns[4:], arrivals_ns[4:])] == [StampKind.NEXT] * 2
    assert [clock.inner_ns(stamp_ns) for stamp_ns in stamps_ns[3:]] == [START_NS + k * STEP_NS for k in (3, 4, 5)]


def test_samples_that_change_places_and_arrive_all_at_once_are_late_and_no_clock():
    clock = DataClock()
    clock.take(START_NS, 0)
    clock.take(START_NS + 5 * STEP_NS, 5 * STEP_NS)
    late_ns = [START_NS + k * STEP_NS for k in range(1, 5)]
    assert [clock.take(stamp_ns, 5 * STEP_NS + 10**6) for stamp_ns in late_ns] == [StampKind.LATE] * 4
    assert clock.take(START_NS + 6 * STEP_NS, 6 * STEP_NS) is StampKind.NEXT
