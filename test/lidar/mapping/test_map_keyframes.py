# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.lidar.mapping.graph import Relation
from ceiling_dso_ros.lidar.mapping.map_keyframes import MOST_VIEWS, MapKeyframes
from ceiling_dso_ros.lidar.scans.poses import between, compose, expmap

NEAR_M, NEAR_RAD = 0.4, 0.26


def laps(count, rng, length=30):
    """On a circle of 12 m, each time a little beside the way of the time before."""
    turns = 2.0 * np.pi * np.arange(count * length) / length
    poses = np.column_stack([2.0 * np.cos(turns), 2.0 * np.sin(turns), turns + np.pi / 2.0])
    return poses + 0.05 * rng.standard_normal(poses.shape) * (1.0, 1.0, 0.1)


def chosen_of(poses):
    return MapKeyframes.choose(np.arange(len(poses)) * 7, poses, NEAR_M, NEAR_RAD)


def steps_of(poses, rng):
    moved = between(poses[:-1], poses[1:])
    roots = 0.01 * rng.standard_normal((len(moved), 3, 3))
    return [Relation(k, k + 1, m, r @ r.T + 1e-6 * np.eye(3)) for k, (m, r) in enumerate(zip(moved, roots))]


def test_further_laps_add_no_keyframes_to_the_map():
    poses = laps(10, np.random.default_rng(0))
    counts = [len(chosen_of(poses[: 30 * number]).chosen) for number in (1, 3, 10)]
    assert counts[0] == 30
    assert counts[1] <= 30 * (MOST_VIEWS + 1)
    assert counts[2] <= 1.2 * counts[1]


def test_who_comes_from_the_other_side_sees_something_else():
    there = np.column_stack([np.arange(0.0, 6.0, 0.5), np.zeros(12), np.zeros(12)])
    back = there[::-1] + np.array([0.0, 0.0, np.pi])
    assert len(chosen_of(np.concatenate([there, back])).chosen) == 24


def test_the_others_are_near_their_host_and_move_with_it():
    poses = laps(6, np.random.default_rng(1))
    keyframes = chosen_of(poses)
    hosts = keyframes.map_poses[keyframes.hosts]
    assert np.hypot(*(hosts - poses)[:, :2].T).max() < NEAR_M
    np.testing.assert_array_equal(keyframes.hosts[keyframes.chosen], np.arange(len(keyframes.chosen)))
    motion = np.array([0.3, -0.2, 0.1])
    moved = keyframes.carried(compose(np.tile(motion, (len(keyframes.chosen), 1)), keyframes.map_poses))
    np.testing.assert_allclose(between(compose(np.tile(motion, (len(poses), 1)), poses), moved), 0.0, atol=1e-9)


def test_backwards_is_the_same_choice():
    keyframes = chosen_of(laps(4, np.random.default_rng(2)))
    turned = keyframes.backwards()
    np.testing.assert_array_equal(turned.map_scans, keyframes.map_scans[::-1])
    np.testing.assert_array_equal(
        turned.map_scans[turned.hosts], keyframes.map_scans[keyframes.hosts][::-1]
    )  # fmt: skip


def test_steps_between_chosen_keyframes_are_composed_with_their_errors():
    rng = np.random.default_rng(3)
    poses = laps(5, rng)
    keyframes, steps = chosen_of(poses), steps_of(poses, rng)
    relations = keyframes.relations(steps, [])
    assert len(relations) == len(keyframes.chosen) - 1
    gap = max(relations, key=lambda each: keyframes.chosen[each.second] - keyframes.chosen[each.first])
    first, last = int(keyframes.chosen[gap.first]), int(keyframes.chosen[gap.second])
    assert last - first > 3
    np.testing.assert_allclose(between(gap.moved, between(poses[first], poses[last])), 0.0, atol=1e-9)
    # against draws of the steps' errors, each seen from the keyframe that the step leads to
    drawn = np.zeros((20000, 3))
    for step in steps[first:last]:
        errors = rng.multivariate_normal(np.zeros(3), 1e-4 * step.covariance, len(drawn))
        drawn = compose(drawn, compose(np.tile(step.moved, (len(drawn), 1)), expmap(errors)))
    scatter = np.cov(between(np.tile(gap.moved, (len(drawn), 1)), drawn).T)
    assert scatter == pytest.approx(1e-4 * gap.covariance, rel=0.1, abs=0.05 * 1e-4 * gap.covariance.max())


def test_a_step_that_nobody_knows_leaves_a_gap_and_loops_between_others_are_left_out():
    rng = np.random.default_rng(4)
    poses = laps(3, rng)
    keyframes = chosen_of(poses)
    steps = [step for step in steps_of(poses, rng) if step.first != 10]
    assert len(keyframes.relations(steps, [])) == len(keyframes.chosen) - 2
    left_out = next(number for number in range(len(poses)) if number not in keyframes.chosen)
    loop = Relation(5, 35, np.zeros(3), np.eye(3))
    found = keyframes.relations([], [Relation(0, left_out, np.zeros(3), np.eye(3)), loop])
    if 35 in keyframes.chosen:
        assert [(each.first, each.second) for each in found] == [(5, keyframes.chosen.tolist().index(35))]
    else:
        assert found == []
