# SPDX-License-Identifier: BSD-3-Clause
"""How `scripts/bench faults` judges, and some of its faults on nodes that really run."""

import dataclasses

import numpy as np
import pytest

from ceiling_dso_ros.fusion import planar

outcome = pytest.importorskip("support.faults.outcome")
Fault, Outcome = outcome.Fault, outcome.Outcome

GOOD = Outcome(0.3, 0.05, 0.001, 0.001, 0.01, 0.2, 0, 1.0)


def fault(**fields):
    return Fault("camera", "something", lambda live: None, **fields)


def problems(asked, **seen):
    found = dataclasses.replace(GOOD, problems=[], **seen)
    found.judge(asked)
    return found.problems


def test_what_is_as_it_must_be_holds():
    assert problems(fault(says="words")) == []


@pytest.mark.parametrize(
    ("asked", "seen", "words"),
    [
        ({"says": "words"}, {"said_after_s": None}, "never"),
        ({"says": "words", "within_s": 0.2}, {}, "after 0.3 s"),
        ({}, {"gap_s": 0.6}, "no output for 0.60 s"),
        ({}, {"gap_s": np.nan}, "no output"),
        ({}, {"jump_m": 0.1}, "jump of 100 mm"),
        ({}, {"jump_m": np.nan}, "jump"),
        ({}, {"jump_rad": 0.1}, "0.100 rad"),
        ({}, {"error_m": 0.1}, "100 mm off, limit 30"),
        ({"is_blind": True}, {"error_m": 0.3}, "300 mm off, limit 200"),
        ({}, {"losses": 1}, "1 maps lost"),
        ({}, {"recovered_after_s": None}, "not recovered"),
        ({}, {"recovered_after_s": 9.0}, "not recovered"),
    ],
)
def test_what_is_not_is_named(asked, seen, words):
    (found,) = problems(fault(**asked), **seen)
    assert words in found


def test_who_is_blind_may_err_as_the_wheels_do_and_who_begins_anew_has_no_error():
    assert problems(fault(is_blind=True), error_m=0.15) == []
    assert problems(fault(begins_anew=True), error_m=np.nan, jump_m=np.nan) == []


def test_a_jump_is_what_the_pose_does_beyond_the_motion():
    truth = np.array([[0.1 * k, 0.0, 0.02 * k] for k in range(10)])
    poses = np.array([planar.compose(np.array([3.0, -1.0, 0.7]), pose) for pose in truth])
    assert outcome.largest_jump(poses, truth) == pytest.approx((0.0, 0.0), abs=1e-9)
    poses[6:, :2] += [0.03, 0.04]
    poses[8:, 2] += 0.2
    jump_m, jump_rad = outcome.largest_jump(poses, truth)
    assert jump_m == pytest.approx(0.05, abs=1e-9)
    assert jump_rad == pytest.approx(0.2, abs=1e-9)
    assert all(np.isnan(outcome.largest_jump(poses[:1], truth[:1])))


def test_the_error_of_a_motion_does_not_depend_on_where_it_began():
    start, end = np.array([1.0, 2.0, 0.5]), np.array([2.0, 4.0, 1.0])
    moved = np.array([-3.0, 1.0, 2.0])
    args = planar.compose(moved, start), planar.compose(moved, end), start, end
    assert outcome.motion_error_m(*args) == pytest.approx(0.0, abs=1e-9)
    assert outcome.motion_error_m(start, end + np.array([0.3, -0.4, 0.0]), start, end) == pytest.approx(0.5, abs=1e-9)


# One of each kind that needs real nodes most: images, the clock, a process.
LIVE = ("frozen", "back_a_second", "kill_dso")


@pytest.mark.ros
@pytest.mark.parametrize("name", LIVE)
def test_the_nodes_bear_it(name, tmp_path_factory):
    faults = pytest.importorskip("faults")
    folder = tmp_path_factory.getbasetemp() / "faults"
    if faults.ros_environment(folder / "log") is None:
        pytest.skip("needs ROS and the built workspace")
    assert faults.run(name, folder).problems == []
