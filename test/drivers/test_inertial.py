# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.drivers.image_times import COUNTER_US
from ceiling_dso_ros.drivers.inertial import MOST_WAITING, InertialPairs
from ceiling_dso_ros.drivers.reports import InertialReading


@pytest.mark.parametrize("start_us", [0, COUNTER_US - 17_000])
def test_accelerations_are_interpolated_at_the_times_of_the_rates(start_us):
    pairs = InertialPairs()
    found = []
    for time_us in range(0, 100_000, 1000):
        counter_us = (start_us + time_us) % COUNTER_US
        if time_us % 10_000 == 0:
            found += pairs.add(InertialReading(counter_us, False, (time_us, 0.0, -9.81)))
        if time_us % 5000 == 2000:
            found += pairs.add(InertialReading(counter_us, True, (0.0, 0.0, time_us)))
    times_us = [(sample.counter_us - start_us) % COUNTER_US for sample in found]
    assert times_us == list(range(2000, 90_000, 5000))
    for time_us, sample in zip(times_us, found):
        np.testing.assert_allclose(sample.force, [time_us, 0.0, -9.81])
        np.testing.assert_allclose(sample.rate, [0.0, 0.0, time_us])


def test_rates_without_accelerations_do_not_add_up():
    pairs = InertialPairs()
    for time_us in range(3 * MOST_WAITING):
        assert list(pairs.add(InertialReading(time_us, True, (0.0, 0.0, 0.0)))) == []
    assert len(pairs._rates) == MOST_WAITING
