# SPDX-License-Identifier: BSD-3-Clause
"""Clocks that were set, told from messages that come late."""

import re

import numpy as np
import pytest

from ceiling_dso_ros.io.arrival_clock import TOLERANCE_NS, ArrivalClock, ClockAgreement

BEGIN_NS = 1_732_800_000_123_456_789
SECOND_NS = 10**9


class Stream:
    """Messages at a rate, each a random time late."""

    def __init__(self, take, rate_hz, latency_s, seed=0):
        self.take, self.rate_hz, self.latency_s = take, rate_hz, latency_s
        self.random = np.random.default_rng(seed)
        self.number, self.arrival_ns = 0, 0

    def send(self, count, set_s=0.0, late_s=0.0):
        """Messages by a clock that is `set_s` wrong, which also come `late_s` late."""
        for _ in range(count):
            self.number += 1
            sent_ns = round(1e9 * self.number / self.rate_hz)
            delay_s = late_s + self.random.exponential(self.latency_s)
            self.arrival_ns = max(sent_ns + round(1e9 * delay_s), self.arrival_ns + 1)  # in order
            self.take(BEGIN_NS + sent_ns + round(1e9 * set_s), self.arrival_ns)


class FollowedStream(Stream):
    """The same with a clock that follows it."""

    def __init__(self, rate_hz, latency_s, seed=0):
        self.clock, self.shifts_ns = ArrivalClock(), []
        super().__init__(self.follow, rate_hz, latency_s, seed)

    def follow(self, stamp_ns, arrival_ns):
        self.clock.take(stamp_ns, arrival_ns)
        self.shifts_ns.append(self.clock.shift_ns)

    def shifts(self, count, set_s=0.0, late_s=0.0):
        """The shifts of the clock after each of these messages."""
        self.send(count, set_s, late_s)
        return self.shifts_ns[-count:]


RATES = pytest.mark.parametrize("rate_hz", [3.0, 15.0, 50.0, 200.0])
SEEDS = pytest.mark.parametrize("seed", range(5))


@RATES
@SEEDS
def test_messages_that_come_late_are_no_step(rate_hz, seed):
    stream = FollowedStream(rate_hz, 0.02, seed)
    shifts = [*stream.shifts(60), *stream.shifts(5, late_s=0.3), *stream.shifts(60), *stream.shifts(40, late_s=3.0)]
    shifts += [*stream.shifts(60), *stream.shifts(1, late_s=0.9), *stream.shifts(200)]
    assert max(map(abs, shifts)) <= TOLERANCE_NS


@RATES
@SEEDS
@pytest.mark.parametrize("set_s", [0.15, 0.3, 1.0, 3600.0, -0.15, -0.3, -1.0, -3600.0])
def test_a_step_is_found_with_its_size_at_its_message_and_taken_back(rate_hz, seed, set_s):
    stream = FollowedStream(rate_hz, 0.01, seed)
    assert not any(stream.shifts(60))
    first, *_, last = stream.shifts(40, set_s)
    assert first == pytest.approx(1e9 * set_s, abs=60e6)
    assert last == pytest.approx(1e9 * set_s, abs=10e6)
    *_, last = stream.shifts(40)
    assert last == pytest.approx(0.0, abs=10e6)


@RATES
@pytest.mark.parametrize("set_s", [0.4, 3600.0, -0.4, -3600.0])
def test_one_wrong_stamp_costs_itself(rate_hz, set_s):
    stream = FollowedStream(rate_hz, 0.005)
    assert not any(stream.shifts(60))
    assert [*stream.shifts(1, set_s)] != [0]
    assert max(map(abs, stream.shifts(60))) < TOLERANCE_NS


@pytest.mark.parametrize("drift", [100e-6, -100e-6])
def test_clocks_that_drift_are_not_set(drift):
    clock, random = ArrivalClock(), np.random.default_rng(0)
    for number in range(60_000):
        sent_ns = number * SECOND_NS // 15
        stamp_ns = BEGIN_NS + round(sent_ns * (1.0 + drift) + 1e9 * random.uniform(-0.01, 0.01))
        clock.take(stamp_ns, sent_ns + round(1e9 * random.exponential(0.01)))
    assert clock.shift_ns == 0


@RATES
def test_dropped_and_lost_messages_are_no_step(rate_hz):
    stream = FollowedStream(rate_hz, 0.01)
    shifts = [*stream.shifts(60)]
    for gap in (1, 3, 30, 300):
        stream.number += gap
        shifts += stream.shifts(60)
    assert not any(shifts)


@SEEDS
@pytest.mark.parametrize("kept", [2, 3, 5])
def test_a_busy_computer_that_leaves_images_out_sets_no_clock(seed, kept):
    """Of some images every second or third is used, all come late, by times that change, and then it is over."""
    stream = FollowedStream(15.0, 0.005, seed)
    assert not any(stream.shifts(100))
    while stream.number < 4000:
        if stream.random.random() < 0.3:
            stream.number += stream.random.integers(kept)
        stream.shifts(1, late_s=0.2 + stream.random.exponential(0.3))
    assert max(map(abs, stream.shifts(100))) <= TOLERANCE_NS
    assert abs(stream.clock.shift_ns) <= TOLERANCE_NS


@SEEDS
def test_what_seemed_to_be_a_step_back_and_was_a_delay_is_withdrawn(seed):
    """Long after it: the computer was busy for minutes."""
    stream = FollowedStream(15.0, 0.005, seed)
    assert not any(stream.shifts(200))
    for _ in range(400):  # only every third image is used
        stream.number += 2
        stream.shifts(1, late_s=0.05)
    assert stream.shifts(1, late_s=0.4)[0] < -TOLERANCE_NS  # for once its interval is that of the camera
    assert max(stream.shifts(300, late_s=0.4)) < -TOLERANCE_NS
    assert abs(stream.shifts(20)[-1]) <= TOLERANCE_NS


@RATES
def test_two_messages_that_changed_places_cost_themselves_at_most(rate_hz):
    stream = FollowedStream(rate_hz, 0.002)
    assert not any(stream.shifts(60))
    for ahead in (1, -2, 1):  # the second of two comes first
        stream.number += ahead
        stream.shifts(1)
    assert max(map(abs, stream.shifts(60))) < TOLERANCE_NS
    assert stream.shifts(1, -1.0)[0] == pytest.approx(-1e9, abs=60e6)


@pytest.mark.parametrize("stamp_s", [0.0, 1e9])
def test_stamps_that_never_change_are_no_clock(stamp_s):
    clock = ArrivalClock()
    for number in range(200):
        clock.take(round(1e9 * stamp_s), number * SECOND_NS // 15)
    assert clock.shift_ns == 0


def test_other_rates_are_no_step():
    stream = FollowedStream(30.0, 0.01)
    shifts = [*stream.shifts(60)]
    for rate_hz in (3.0, 60.0, 15.0, 90.0):
        stream.number = round(stream.number / stream.rate_hz * rate_hz) + 1
        stream.rate_hz = rate_hz
        shifts += stream.shifts(60)
    assert not any(shifts)


@SEEDS
@pytest.mark.parametrize("set_s", [0.3, -0.3, 1.0, -1.0, 3600.0])
def test_two_clocks_agree_again_when_both_were_set(set_s, seed):
    clocks = ClockAgreement()
    images, wheels = Stream(clocks.take_image, 15.0, 0.03, seed), Stream(clocks.take_wheels, 50.0, 0.005, seed)
    images.send(60)
    wheels.send(200)
    for now_s, before_s in zip((set_s, 0.0) * 3, (0.0, set_s) * 3):
        images.send(60, now_s)
        assert clocks.apart_ns == pytest.approx(1e9 * (now_s - before_s), abs=TOLERANCE_NS)
        assert f"clock of the images was set {'ahead' if now_s > before_s else 'back'} by" in clocks.disagreement
        wheels.send(200, now_s)
        assert clocks.apart_ns == 0
        assert clocks.disagreement == ""
    clocks.forget()
    assert clocks.apart_ns == 0


@SEEDS
@pytest.mark.parametrize("set_s", [0.3, -0.3, 3600.0])
def test_the_clock_that_was_set_is_named(set_s, seed):
    clocks = ClockAgreement()
    images, wheels = Stream(clocks.take_image, 15.0, 0.03, seed), Stream(clocks.take_wheels, 50.0, 0.005, seed)
    images.send(60)
    wheels.send(200)
    wheels.send(200, set_s)
    way = "ahead" if set_s > 0.0 else "back"
    assert re.fullmatch(
        rf"the clock of the wheels was set {way} by [0-9.]+ s, that of the images was not", clocks.disagreement
    )


def test_what_comes_late_at_the_start_is_no_step():
    """Kernels are being loaded, and then only the newest image is used."""
    clock = ArrivalClock()
    for number, (stamp_s, arrival_s) in enumerate([(0.0, 1.5), (1.48, 1.52), (1.54, 1.58)]):
        clock.take(BEGIN_NS + round(1e9 * stamp_s), round(1e9 * arrival_s))
        assert clock.shift_ns == 0, number
