# SPDX-License-Identifier: BSD-3-Clause
"""Rows of active points and of their residuals stay together and sorted."""

import numpy as np
import pytest

from ceiling_dso_ros.dso.window.points import INLIER, NONE, OUTLIER, PointTable

TARGETS = 4


def add(table, host, n, first_tag, targets=(0, 1, 2)):
    """Points whose every field tells which point it is."""
    tag = np.arange(first_tag, first_tag + n, dtype=np.float32)
    live = np.zeros((TARGETS, n), np.uint8)
    live[[t for t in targets if t != host]] = 1
    pattern = tag + 1000 * np.arange(8, dtype=np.float32)[:, None]
    table.append(tag, 2 * tag, 3 * tag, pattern, -pattern, 4 * tag, np.full(n, host), live)


def consistent(table):
    a, n = table.arrays, table.count
    tag = a.u[:n]
    np.testing.assert_array_equal(a.v[:n], 2 * tag)
    np.testing.assert_array_equal(a.kind[:n], 3 * tag)
    np.testing.assert_array_equal(a.idepth[:n], 4 * tag)
    np.testing.assert_array_equal(a.grey[:, :n], tag + 1000 * np.arange(8)[:, None])
    np.testing.assert_array_equal(a.weight[:, :n], -(tag + 1000 * np.arange(8)[:, None]))
    np.testing.assert_array_equal(a.host[:n], np.sort(a.host[:n]))
    assert not table.residuals.live[a.host[:n], np.arange(n)].any()
    return tag.astype(int).tolist()


@pytest.fixture
def table():
    table = PointTable(TARGETS, 30)
    add(table, 2, 4, 20)
    add(table, 0, 3, 0)
    add(table, 1, 5, 10)
    return table


def test_appended_points_are_sorted_by_host(table):
    assert consistent(table) == [0, 1, 2, 10, 11, 12, 13, 14, 20, 21, 22, 23]
    assert table.host_ranges(4).tolist() == [0, 3, 8, 12, 12]
    expected = np.array([0, 1, 1, 0])[:, None] * np.ones(3)
    np.testing.assert_array_equal(table.residuals.live[:, :3], expected)
    np.testing.assert_array_equal(table.residuals.state[:, :3], np.where(expected, INLIER, NONE))


def test_new_points_come_after_the_older_ones_of_their_host(table):
    table.arrays.good_residuals[:12] = 7
    table.arrays.idepth_hessian[:12] = 9
    add(table, 0, 2, 5)
    assert consistent(table)[:6] == [0, 1, 2, 5, 6, 10]
    assert table.arrays.good_residuals[:6].tolist() == [7, 7, 7, 0, 0, 7]
    assert table.arrays.idepth_hessian[:6].tolist() == [9, 9, 9, 0, 0, 9]


def test_what_does_not_fit_is_left_out(table):
    add(table, 1, 40, 100)
    assert table.count == table.capacity == 30
    assert consistent(table)[8:10] == [100, 101]


def test_a_new_target_sees_all_points_but_its_own(table):
    table.add_target(3)
    assert table.residuals.live[3, :12].all()
    table.add_target(1)
    assert table.residuals.live[1, :12].tolist() == [1] * 3 + [0] * 5 + [1] * 4
    assert table.residuals.state[1, :12].tolist() == [INLIER] * 3 + [NONE] * 5 + [INLIER] * 4


def test_keep_keeps_whole_rows(table):
    table.residuals.energy[:, :12] = table.arrays.u[:12] + 100 * np.arange(TARGETS)[:, None]
    table.residuals.idepth_relative[:, :, :12] = table.arrays.u[:12]
    table.keep(np.isin(table.arrays.u[:12], [1, 11, 13, 20]))
    assert consistent(table) == [1, 11, 13, 20]
    np.testing.assert_array_equal(
        table.residuals.energy[:, :4], np.array([1, 11, 13, 20]) + 100 * np.arange(TARGETS)[:, None]
    )


@pytest.mark.parametrize("slot", [0, 1, 2])
def test_a_removed_keyframe_takes_its_points_and_residuals(table, slot):
    table.add_target(3)
    table.residuals.state[slot, :12] = OUTLIER  # nothing of this row may survive
    table.residuals.energy[:, :12] = 10 * np.arange(TARGETS)[:, None]
    tags = [
        tag
        for tag, host in zip([0, 1, 2, 10, 11, 12, 13, 14, 20, 21, 22, 23], [0] * 3 + [1] * 5 + [2] * 4)
        if host != slot
    ]
    table.remove_keyframe(slot)
    assert consistent(table) == tags
    assert table.arrays.host[: table.count].max() == 1
    others = [10 * t for t in range(TARGETS) if t != slot]
    np.testing.assert_array_equal(table.residuals.energy[: TARGETS - 1, 0], others)
    assert table.residuals.live[2, : table.count].all()  # the former keyframe 3
    assert not (table.residuals.state[:, : table.count] == OUTLIER).any()
    assert not table.residuals.live[TARGETS - 1].any()
