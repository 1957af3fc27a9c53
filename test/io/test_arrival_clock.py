# SPDX-License-Identifier: BSD-3-Clause
"""Clocks that were set, told from messages that come late."""

import numpy as np
import pytest

from ceiling_dso_ros.io.arrival_clock import TOLERANCE_NS, ArrivalClock, ClockAgreement

BEGIN_NS = 1_732_800_000_123_456_789
SECOND_NS = 10**9


class Stream:
    """Messages at a rate, each a random time late."""

    def __init__(self, clock, rate_hz, latency_s, seed=0):
        self.clock, self.rate_hz, self.latency_s = clock, rate_hz, latency_s
        self.random = np.random.default_rng(seed)
        self.number, self.arrival_ns = 0, 0

    def send(self, count, set_s=0.0, late_s=0.0):
        """Messages by a clock that is `set_s` wrong, which also come `late_s` late; yields the shift after each."""
        for _ in range(count):
            self.number += 1
            sent_ns = round(1e9 * self.number / self.rate_hz)
            delay_s = late_s + self.random.exponential(self.latency_s)
            self.arrival_ns = max(sent_ns + round(1e9 * delay_s), self.arrival_ns + 1)  # in order
            self.clock.take(BEGIN_NS + sent_ns + round(1e9 * set_s), self.arrival_ns)
            yield self.clock.shift_ns


RATES = pytest.mark.parametrize("rate_hz", [3.0, 15.0, 50.0, 200.0])
SEEDS = pytest.mark.parametrize("seed", range(5))


@RATES
@SEEDS
def test_messages_that_come_late_are_no_step(rate_hz, seed):
    stream = Stream(ArrivalClock(), rate_hz, 0.02, seed)
    shifts = [*stream.send(60), *stream.send(5, late_s=0.3), *stream.send(60), *stream.send(40, late_s=3.0)]
    shifts += [*stream.send(60), *stream.send(1, late_s=0.9), *stream.send(200)]
    assert max(map(abs, shifts)) <= TOLERANCE_NS


@RATES
@SEEDS
@pytest.mark.parametrize("set_s", [0.15, 0.3, 1.0, 3600.0, -0.15, -0.3, -1.0, -3600.0])
def test_a_step_is_found_with_its_size_at_its_message_and_taken_back(rate_hz, seed, set_s):
    stream = Stream(ArrivalClock(), rate_hz, 0.01, seed)
    assert not any(stream.send(60))
    first, *_, last = stream.send(40, set_s)
    assert first == pytest.approx(1e9 * set_s, abs=60e6)
    assert last == pytest.approx(1e9 * set_s, abs=10e6)
    *_, last = stream.send(40)
    assert last == pytest.approx(0.0, abs=10e6)


@RATES
@pytest.mark.parametrize("set_s", [0.4, 3600.0, -0.4, -3600.0])
def test_one_wrong_stamp_costs_itself(rate_hz, set_s):
    stream = Stream(ArrivalClock(), rate_hz, 0.005)
    assert not any(stream.send(60))
    assert [*stream.send(1, set_s)] != [0]
    assert max(map(abs, stream.send(60))) < TOLERANCE_NS


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
    stream = Stream(ArrivalClock(), rate_hz, 0.01)
    shifts = [*stream.send(60)]
    for gap in (1, 3, 30, 300):
        stream.number += gap
        shifts += stream.send(60)
    assert not any(shifts)


def test_other_rates_are_no_step():
    stream = Stream(ArrivalClock(), 30.0, 0.01)
    shifts = [*stream.send(60)]
    for rate_hz in (3.0, 60.0, 15.0, 90.0):
        stream.number = round(stream.number / stream.rate_hz * rate_hz) + 1
        stream.rate_hz = rate_hz
        shifts += stream.send(60)
    assert not any(shifts)


@SEEDS
@pytest.mark.parametrize("set_s", [0.3, -0.3, 1.0, -1.0, 3600.0])
def test_two_clocks_agree_again_when_both_were_set(set_s, seed):
    clocks = ClockAgreement()
    images, wheels = Stream(clocks.images, 15.0, 0.03, seed), Stream(clocks.wheels, 50.0, 0.005, seed)
    for _ in range(5):
        assert not any([*images.send(60), *wheels.send(200)])
        assert clocks.apart_ns == 0
        [*images.send(60, set_s)]
        assert clocks.apart_ns == pytest.approx(1e9 * set_s, abs=TOLERANCE_NS)
        [*wheels.send(200, set_s)]
        assert clocks.apart_ns == 0
        assert clocks.images.shift_ns == clocks.wheels.shift_ns == 0
        [*images.send(60), *wheels.send(200)]
        assert clocks.apart_ns == 0
    clocks.forget()
    assert clocks.apart_ns == 0


def test_what_comes_late_at_the_start_is_no_step():
    """Kernels are being loaded, and then only the newest image is used."""
    clock = ArrivalClock()
    for number, (stamp_s, arrival_s) in enumerate([(0.0, 1.5), (1.48, 1.52), (1.54, 1.58)]):
        clock.take(BEGIN_NS + round(1e9 * stamp_s), round(1e9 * arrival_s))
        assert clock.shift_ns == 0, number
