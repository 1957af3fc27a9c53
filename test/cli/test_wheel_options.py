# SPDX-License-Identifier: BSD-3-Clause
import argparse

import pytest

from ceiling_dso_ros.cli.wheel_options import add_wheel_options, topics_of_wheels
from ceiling_dso_ros.io.errors import InputError


def topics(*words):
    parser = argparse.ArgumentParser()
    add_wheel_options(parser)
    return topics_of_wheels(parser.parse_args(words))


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("", {"wheel_input": ""}),
        ("--wheel-input odometry", {"wheel_input": "odometry"}),
        ("--wheel-odometry /my/odom", {"wheel_input": "odometry", "wheel_odometry": "/my/odom"}),
        ("--left-joint a --right-joint b", {"wheel_input": "joint_states", "left_joint": "a", "right_joint": "b"}),
        ("--right-ticks /r --wheel-input ticks", {"wheel_input": "ticks", "right_ticks": "/r"}),
        ("--base-frame a --camera-frame b", {"wheel_input": "", "base_frame": "a", "camera_frame": "b"}),
    ],
)
def test_options_say_which_data_is_used(words, expected):
    assert topics(*words.split()) == expected


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--wheel-odometry", "/o", "--left-joint", "a"], "--left-joint and --wheel-odometry name different data"),
        (
            ["--wheel-odometry", "/o", "--wheel-input", "ticks"],
            "--wheel-odometry and --wheel-input ticks name different",
        ),
        (["--left-joint", "a", "--right-joint", "a"], "--left-joint and --right-joint are both a: two are needed"),
    ],
)
def test_options_that_contradict_each_other_are_refused(words, complaint):
    with pytest.raises(InputError, match=complaint):
        topics(*words)


def test_a_command_without_these_options_has_no_topics_of_its_own():
    assert topics_of_wheels(argparse.Namespace()) == {"wheel_input": ""}
