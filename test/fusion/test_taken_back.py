# SPDX-License-Identifier: BSD-3-Clause
import dataclasses

import numpy as np
import pytest
from test_slip import NOISE, SCALE, SIGMA, STEP_NS, interval

from ceiling_dso_ros.fusion.config import FusionConfig
from ceiling_dso_ros.fusion.slip import SlipMonitor
from ceiling_dso_ros.fusion.taken_back import LONGEST_S, TakenBack


@pytest.fixture
def see():
    """Judges intervals in order; returns the ends of what each takes back."""
    monitor = SlipMonitor(FusionConfig(), NOISE)
    taken_back = TakenBack(monitor)

    def ends(*intervals):
        results = []
        for each in intervals:
            found = None if each.visual is None else monitor.compare(each.wheels, each.visual, SCALE, SIGMA)
            judged = dataclasses.replace(each, wheels_slip=found is not None and monitor.beyond_gate(found, True))
            results.append([other.end for other in taken_back.see(judged, SCALE, SIGMA)])
        return results

    return ends


def leap(end, forward_m=0.1, turn_rad=0.25):
    return interval(end, camera=(0.15 + forward_m, 0.01 + turn_rad))


def test_an_image_that_leaps_and_leaps_back_was_no_slip(see):
    back = leap(3, 0.0, -0.25)
    # The camera turned by 0.25 rad on its way; what it sees of the way back, it sees in its own axes.
    turned = dataclasses.replace(
        back, visual=dataclasses.replace(back.visual, shift=back_shift(np.array([0.25, 0.0]), 0.26))
    )
    assert see(interval(1), leap(2), turned, interval(4)) == [[], [], [2, 3], []]


def back_shift(there_m, turn_rad):
    """Units: from where the camera seemed to be to where the wheels say it is after two steps, in its axes."""
    first, second = np.array([0.15, 0.0]), np.array([0.15 * np.cos(0.01), 0.15 * np.sin(0.01)])
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    return np.array([[c, s], [-s, c]]) @ (first + second - there_m) / SCALE


def test_what_wheels_slipped_stays(see):
    assert see(interval(1), leap(2), interval(3), leap(4), interval(5)) == [[]] * 5


def test_a_slip_that_goes_on_is_not_taken_back(see):
    slipping = [interval(end, wheel=(0.3, 0.01)) for end in range(2, 12)]
    assert see(interval(1), *slipping) == [[]] * 11


def test_not_after_a_long_time_nor_across_maps(see):
    steps = int(LONGEST_S / (1e-9 * STEP_NS)) + 1
    between = [interval(end) for end in range(3, 3 + steps)]
    assert see(leap(2, 0.0), *between, leap(3 + steps, 0.0, -0.25))[-1] == []
    other_map = dataclasses.replace(leap(3, 0.0, -0.25), continues=False)
    assert see(leap(2, 0.0), other_map)[-1] == []
