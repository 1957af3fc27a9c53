# SPDX-License-Identifier: BSD-3-Clause
import pytest

from ceiling_dso_ros.dso.durations import nanoseconds
from ceiling_dso_ros.fusion.config import SlipConfig
from ceiling_dso_ros.fusion.contradiction import Contradiction

IMAGE_NS = nanoseconds(0.033)


@pytest.fixture
def contradiction():
    return Contradiction(SlipConfig(longest_s=2.0))


def contradicted(contradiction, start_s, end_s, at_once=True):
    """Every image from start to end contradicts the wheels; returns the stamp of the last one."""
    now_ns = nanoseconds(start_s)
    while now_ns + IMAGE_NS <= nanoseconds(end_s):
        contradiction.found(now_ns, now_ns + IMAGE_NS, at_once)
        now_ns += IMAGE_NS
    return now_ns


def test_a_slip_lasts_as_long_as_it_is_seen(contradiction):
    now_ns = contradicted(contradiction, 0.0, 1.0)
    assert contradiction.lasts(now_ns + 1)
    assert contradiction.replaces_wheels(now_ns + 1)
    contradiction.not_found()
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


def test_without_a_new_keyframe_the_camera_is_doubted_after_some_time(contradiction):
    contradicted(contradiction, 1.0, 2.9)
    assert not contradiction.camera_doubted
    now_ns = contradicted(contradiction, 2.9, 3.2)
    assert contradiction.camera_doubted
    assert contradiction.since_ns == nanoseconds(1.0)
    assert not contradiction.replaces_wheels(now_ns)
    contradiction.not_found()  # the wheels stop, too: the camera may still show one picture all the time
    assert contradiction.camera_doubted
    contradiction.new_keyframe(now_ns)
    assert not contradiction.camera_doubted


def test_keyframes_and_agreement_give_the_camera_more_time(contradiction):
    for begin_s in (0.0, 1.5, 3.0):
        contradiction.new_keyframe(contradicted(contradiction, begin_s, begin_s + 1.5))
    for begin_s in (4.5, 6.0):
        contradiction.not_found()
        contradicted(contradiction, begin_s, begin_s + 1.5)
    assert not contradiction.camera_doubted
