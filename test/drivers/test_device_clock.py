# SPDX-License-Identifier: BSD-3-Clause
"""The time of a device's counter, from simulated arrivals whose true times are known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ceiling_dso_ros.drivers.device_clock import CONFIRMATIONS, LARGEST_STEP_NS, SETTLED_NS, WINDOW_NS, DeviceClock
from ceiling_dso_ros.drivers.image_times import COUNTER_US

MILLISECOND = 1_000_000
START_NS = 5_000_000_000_000  # of the computer's clock
RATE_HZ = 30
SETTLING_S = 10.0  # until when the first fits have seen few readings
LIMIT_NS = MILLISECOND // 2


class Device:
    """A device with a counter of its own, whose images take their time to arrive."""

    def __init__(self, drift_ppm=0.0, counter_us=0, delay=None, seed=0):
        self.drift_ppm, self.counter_us = drift_ppm, counter_us
        rng = np.random.default_rng(seed)
        self._delay_ms = (lambda: rng.uniform(0.0, 5.0)) if delay is None else lambda: delay(rng)
        self.clock = DeviceClock()

    def counter(self, time_s):
        return (self.counter_us + round(time_s * (1e6 + self.drift_ppm))) % COUNTER_US

    def deliver(self, time_s, late_ms=0.0, wrong_us=0):
        """An image that was taken at a time arrives; returns the error of its stamp in ns, None if it is refused."""
        true_ns = START_NS + round(1e9 * time_s)
        arrival_ns = true_ns + round(1e6 * (self._delay_ms() + late_ms))
        counter_us = (self.counter(time_s) + wrong_us) % COUNTER_US
        if not self.clock.add(counter_us, arrival_ns):
            return None
        return self.clock.host_ns(counter_us) - true_ns

    def run(self, start_s, end_s, **options):
        """Errors in ns of all images of a time."""
        times_s = np.arange(round(start_s * RATE_HZ), round(end_s * RATE_HZ)) / RATE_HZ
        return np.array([self.deliver(time_s, **options) for time_s in times_s], float)


DELAYS = {
    "uniform": lambda rng: rng.uniform(0.0, 5.0),
    "exponential": lambda rng: rng.exponential(5.0),
    "half normal": lambda rng: abs(rng.normal(0.0, 5.0)),
    "now and then a second": lambda rng: rng.uniform(0.0, 5.0) + (1000.0 if rng.uniform() < 0.01 else 0.0),
}


@pytest.mark.long
@pytest.mark.parametrize("drift_ppm", [-50.0, 50.0])
@pytest.mark.parametrize("delay", DELAYS)
def test_two_hours_with_drift_and_wrap_arounds(delay, drift_ppm):
    device = Device(drift_ppm, COUNTER_US - 20_000_000, DELAYS[delay])  # wraps after 20 s, then every 71.6 minutes
    errors_ns = device.run(0.0, 7200.0)
    assert not np.isnan(errors_ns).any()
    assert np.abs(errors_ns[round(SETTLING_S * RATE_HZ) :]).max() < LIMIT_NS
    assert device.clock.drift == pytest.approx(-1e-6 * drift_ppm, abs=1e-5)


@pytest.mark.parametrize("seed", range(20))
def test_the_first_stamps_are_right_to_a_millisecond_or_two(seed):
    device = Device(50.0, seed=seed)
    settled_s = 1e-9 * SETTLED_NS
    device.run(0.0, settled_s)
    assert device.clock.is_settled or device.deliver(settled_s) is not None
    assert device.clock.is_settled
    assert np.abs(device.run(settled_s + 1.0 / RATE_HZ, SETTLING_S)).max() < 2 * MILLISECOND


def test_a_busy_computer_changes_little():
    """For three seconds everything arrives a third of a second late."""
    device = Device(50.0)
    device.run(0.0, 60.0)
    assert np.abs(device.run(60.0, 63.0, late_ms=300.0)).max() < LIMIT_NS
    assert np.abs(device.run(63.0, 120.0)).max() < LIMIT_NS


def test_a_single_wrong_counter_is_refused_and_does_no_harm():
    device = Device(50.0)
    device.run(0.0, 30.0)
    for wrong_us in (80_000, -80_000, 2_000_000_000, -2_000_000_000):
        assert device.deliver(30.0, wrong_us=wrong_us) is None
    assert np.abs(device.run(30.1, 90.0)).max() < LIMIT_NS


@pytest.mark.parametrize("step_us", [-3_000_000, 3_000_000, 1_000_000_000, -1_000_000_000])
def test_a_counter_that_was_set_is_believed_after_some_images(step_us):
    device = Device(50.0)
    device.run(0.0, 60.0)
    device.counter_us = (device.counter_us + step_us) % COUNTER_US
    errors_ns = device.run(60.0, 120.0)
    assert np.isnan(errors_ns).nonzero()[0].tolist() == list(range(CONFIRMATIONS - 1))
    assert np.abs(errors_ns[round(SETTLING_S * RATE_HZ) :]).max() < LIMIT_NS


def test_a_counter_that_begins_with_zero_is_believed_after_some_images():
    device = Device(50.0, counter_us=3_000_000_000)
    device.run(0.0, 60.0)
    device.counter_us = -60_000_000 % COUNTER_US
    assert np.abs(device.run(60.0, 120.0)[round(SETTLING_S * RATE_HZ) :]).max() < LIMIT_NS


def test_no_fit_moves_the_stamps_by_more_than_a_step():
    """From now on everything arrives 40 ms later than before, as after a change of the connection."""
    device = Device()
    device.run(0.0, 60.0)
    errors_ns = device.run(60.0, 180.0, late_ms=40.0)
    assert np.abs(np.diff(errors_ns)).max() <= LARGEST_STEP_NS + 100_000
    assert abs(errors_ns[-1] - 40 * MILLISECOND) < LIMIT_NS


def test_what_is_kept_is_bounded():
    device = Device()
    device.run(0.0, 600.0)
    assert len(device.clock._bins) <= 2 * WINDOW_NS / 1e9 + 2


@settings(deadline=None, max_examples=50)
@given(
    drift_ppm=st.floats(-100.0, 100.0),
    counter_us=st.integers(0, COUNTER_US - 1),
    delays_ms=st.lists(st.floats(0.0, 50.0), min_size=2, max_size=300),
)
def test_nothing_arrives_before_it_is_taken(drift_ppm, counter_us, delays_ms):
    clock = DeviceClock()
    for number, delay_ms in enumerate(delays_ms):
        time_s = number / RATE_HZ
        counter = (counter_us + round(time_s * (1e6 + drift_ppm))) % COUNTER_US
        arrival_ns = START_NS + round(1e9 * time_s + 1e6 * delay_ms)
        if clock.add(counter, arrival_ns):
            assert clock.host_ns(counter) <= arrival_ns
