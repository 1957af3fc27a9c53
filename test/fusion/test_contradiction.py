# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.dso.durations import nanoseconds
from ceiling_dso_ros.fusion.config import SlipConfig
from ceiling_dso_ros.fusion.contradiction import Contradiction

IMAGE_NS = nanoseconds(0.033)


@pytest.fixture
def contradiction():
    return Contradiction(SlipConfig(longest_s=2.0))


STILL, MOVED = np.array([1e-4, -1e-4, 1e-5]), np.array([0.03, 0.0, 0.0])


def contradicted(contradiction, start_s, end_s, at_once=True, motion=STILL):
    """Every image from start to end contradicts the wheels; returns the stamp of the last one."""
    now_ns = nanoseconds(start_s)
    while now_ns + IMAGE_NS <= nanoseconds(end_s):
        contradiction.found(now_ns, now_ns + IMAGE_NS, motion, at_once)
        now_ns += IMAGE_NS
    return now_ns


def test_a_slip_lasts_as_long_as_it_is_seen(contradiction):
    now_ns = contradicted(contradiction, 0.0, 1.0)
    assert contradiction.lasts(now_ns + 1)
    assert contradiction.replaces_wheels(now_ns + 1)
    contradiction.not_found(now_ns, STILL)
    assert not contradiction.lasts(now_ns + 1)
    assert not contradiction.replaces_wheels(now_ns + 1)
    assert not contradiction.camera_doubted


def test_a_slip_ends_when_there_are_no_images_any_more(contradiction):
    now_ns = contradicted(contradiction, 0.0, 1.0)
    assert contradiction.replaces_wheels(now_ns + nanoseconds(0.2))
    assert not contradiction.replaces_wheels(now_ns + nanoseconds(0.31))
    assert not contradiction.lasts(now_ns + nanoseconds(0.31))


def test_a_slow_slip_does_not_replace_the_wheels(contradiction):
    now_ns = contradicted(contradiction, 0.0, 1.0, at_once=False)
    assert contradiction.lasts(now_ns)
    assert not contradiction.replaces_wheels(now_ns)


@pytest.mark.parametrize("turn", [False, True])
def test_a_camera_that_stands_is_doubted_after_some_time_until_it_moves(contradiction, turn):
    contradicted(contradiction, 1.0, 2.9)
    assert not contradiction.camera_doubted
    now_ns = contradicted(contradiction, 2.9, 3.2)
    assert contradiction.camera_doubted
    assert contradiction.since_ns == nanoseconds(1.0)
    assert not contradiction.replaces_wheels(now_ns)
    contradiction.not_found(now_ns, STILL)  # the wheels stop, too: the camera may still show one picture all the time
    assert contradiction.camera_doubted
    contradiction.not_found(now_ns, np.array([0.0, 0.0, -0.02]) if turn else MOVED)
    assert not contradiction.camera_doubted


def test_motion_and_agreement_give_the_camera_more_time(contradiction):
    for begin_s in (0.0, 1.5, 3.0):
        now_ns = contradicted(contradiction, begin_s, begin_s + 1.5)
        contradiction.found(now_ns, now_ns + 1, MOVED, at_once=True)
    for begin_s in (4.5, 6.0):
        contradiction.not_found(nanoseconds(begin_s), STILL)
        contradicted(contradiction, begin_s, begin_s + 1.5)
    assert not contradiction.camera_doubted


def test_a_slow_motion_is_one(contradiction):
    contradicted(contradiction, 0.0, 30.0, motion=MOVED / 30.0)
    assert not contradiction.camera_doubted
