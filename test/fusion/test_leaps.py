# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.dso.durations import nanoseconds
from ceiling_dso_ros.fusion.config import OutputConfig
from ceiling_dso_ros.fusion.leaps import Leaps
from ceiling_dso_ros.fusion.twist_filter import MeanTwist

PERIOD_NS = nanoseconds(1 / 15)


def seen(number, speed_m_s=0.5, turn_rad_s=0.2, since=1):
    """The mean twist up to an image, from some images before."""
    rate, end_ns = np.array([speed_m_s, turn_rad_s]), number * PERIOD_NS
    return MeanTwist(end_ns, end_ns - since * PERIOD_NS, end_ns, rate, 1e-6 * np.eye(2), of_wheels=False)


@pytest.fixture
def leaps():
    leaps = Leaps(OutputConfig())
    leaps.leaves_out(seen(1), contradicted=False)
    return leaps


def test_one_image_that_leaps_back_is_not_confirmed(leaps):
    assert leaps.leaves_out(seen(2, turn_rad_s=4.0), contradicted=True)
    assert not leaps.confirms(seen(3, turn_rad_s=-3.6))
    assert not leaps.leaves_out(seen(3, since=2), contradicted=True)  # from the image before it, all is well


def test_a_robot_against_a_wall_is_believed_with_the_next_image(leaps):
    assert leaps.leaves_out(seen(2, speed_m_s=0.0), contradicted=True)
    assert leaps.confirms(seen(3, speed_m_s=0.0))
    assert not leaps.leaves_out(seen(4, speed_m_s=0.0), contradicted=True)


def test_what_a_robot_is_capable_of_is_no_leap(leaps):
    config = OutputConfig()
    for number in range(2, 10):
        speed = 0.5 - config.acceleration_m_s2 * (number - 1) / 15
        assert not leaps.leaves_out(seen(number, speed_m_s=speed), contradicted=True)


def test_nothing_is_known_of_the_first_motion_nor_of_an_image_that_is_not_related():
    leaps = Leaps(OutputConfig())
    assert not leaps.leaves_out(seen(1, turn_rad_s=10.0), contradicted=True)
    assert leaps.leaves_out(seen(2, turn_rad_s=0.0), contradicted=True)
    assert not leaps.confirms(None)
    assert not leaps.confirms(seen(3, turn_rad_s=0.0))  # the leap is forgotten


def test_what_the_wheels_agree_with_is_no_leap(leaps):
    assert not leaps.leaves_out(seen(2, turn_rad_s=4.0), contradicted=False)
    assert not leaps.leaves_out(seen(3, turn_rad_s=4.0), contradicted=True)  # the next one is judged by it


def test_other_accelerations_count_from_then_on(leaps):
    leaps.configure(OutputConfig(acceleration_rad_s2=100.0))
    assert not leaps.leaves_out(seen(2, turn_rad_s=4.0), contradicted=True)
