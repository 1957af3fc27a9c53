# SPDX-License-Identifier: BSD-3-Clause
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from ceiling_dso_ros.io.recording import ImageTimes, RobotDescription, WheelSamples, WheelUnit
from ceiling_dso_ros.playback.wheel_check import uncovered, why_unusable

ROBOT = RobotDescription(4096.0, (0.1, 0.1), 0.5, np.eye(4))
BEGIN_NS, SECOND = 1_732_800_000_000_000_000, 10**9


def recording(images_s=(0.0, 10.0), image_delay_s=0.05, **robot):
    """Of a robot whose images were taken in such a time and recorded so much later."""
    first_ns, last_ns = (BEGIN_NS + int(age_s * SECOND) for age_s in images_s)
    delay_ns = None if image_delay_s is None else int(image_delay_s * SECOND)
    return SimpleNamespace(
        path="a.bag",
        robot=replace(ROBOT, **robot),
        image_times=lambda: ImageTimes(first_ns, last_ns, delay_ns),
    )


def wheels(first_s=0.0, last_s=10.0, delay_s=0.0, unit=WheelUnit.RADIANS):
    stamps_ns = BEGIN_NS + (np.linspace(first_s, last_s, 11) * SECOND).astype(np.int64)
    delay_ns = None if delay_s is None else int(delay_s * SECOND)
    return WheelSamples(unit, stamps_ns, np.zeros((11, 2)), "a.bag, /joint_states", delay_ns)


def test_wheels_on_the_images_clock_can_be_used():
    assert why_unusable(recording(), wheels()) == ""
    assert why_unusable(recording(image_delay_s=None), wheels(delay_s=None)) == ""
    assert why_unusable(recording(image_delay_s=2_592_000.0), wheels(delay_s=2_592_000.0)) == ""  # recorded anew


@pytest.mark.parametrize(
    ("first_s", "last_s", "text"),
    [
        (12.5, 20.0, "a.bag, /joint_states: the wheels and the images do not overlap in time: the wheels begin 2.5 s "
         "after the last image"),
        (-9.0, -1.0, "a.bag, /joint_states: the wheels and the images do not overlap in time: the wheels end 1.0 s "
         "before the first image"),
        (10.0 + 30 * 86400.0, 40.0 + 30 * 86400.0, "a.bag, /joint_states: the wheels and the images do not overlap in "
         "time: the wheels begin 2592000.0 s (30.0 days) after the last image"),
    ],
)  # fmt: skip
def test_wheels_of_another_time_are_said_with_how_far_they_are(first_s, last_s, text):
    assert why_unusable(recording(image_delay_s=None), wheels(first_s, last_s, None)) == text


def test_ticks_that_count_by_the_time_of_recording_come_with_advice():
    of_ticks = why_unusable(recording(), wheels(100.0, 110.0, 0.0, WheelUnit.TICKS))
    assert of_ticks.endswith("; ticks have no stamps, so that the time of their recording counts: use joint_states")
    of_folder = why_unusable(recording(image_delay_s=None), wheels(100.0, 110.0, None, WheelUnit.TICKS))
    assert of_folder.endswith("after the last image")


@pytest.mark.parametrize(("image_delay_s", "order"), [(2.0, "after"), (-2.0, "before")])
def test_two_clocks_are_found_by_when_images_and_wheels_were_recorded(image_delay_s, order):
    problem = why_unusable(recording(image_delay_s=image_delay_s), wheels())
    assert problem == (
        "a.bag, /joint_states: the wheels and the images are on two clocks: what was recorded at the same time is "
        f"stamped 2.0 s {order} the images"
    )


def test_an_offset_of_the_cameras_clock_that_is_known_is_no_problem():
    assert why_unusable(recording(image_delay_s=0.9), wheels())
    assert why_unusable(recording(image_delay_s=0.9, camera_time_offset_s=0.8), wheels()) == ""


def test_an_unknown_robot_is_said():
    unknown = recording()
    unknown.robot = None
    assert why_unusable(unknown, wheels()) == "a.bag: the robot's dimensions are unknown; give them with --robot"


def test_images_without_wheels_are_said():
    assert uncovered(recording(), wheels(0.9, 9.1)) == ""
    assert (
        uncovered(recording(), wheels(2.5, 9.1)) == "a.bag, /joint_states: no wheels for the first 2.5 s of the images"
    )
    assert uncovered(recording(), wheels(2.5, 8.0)).endswith("for the first 2.5 s and the last 2.0 s of the images")
