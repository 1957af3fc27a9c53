# SPDX-License-Identifier: BSD-3-Clause
from ceiling_dso_ros.io.tick_pairs import TickPairs

MS = 1_000_000


def test_both_counters_once_they_are_there():
    pairs = TickPairs()
    assert pairs.add("left", 1000 * MS, 10) is None
    assert pairs.add("right", 1010 * MS, 20) == (1010 * MS, 10, 20)
    assert pairs.add("right", 1020 * MS, 21) is None
    assert pairs.add("left", 1030 * MS, 11) == (1030 * MS, 11, 21)


def test_the_newest_counter_counts():
    pairs = TickPairs()
    pairs.add("left", 1000 * MS, 10)
    pairs.add("left", 1020 * MS, 12)
    assert pairs.add("right", 1030 * MS, 20) == (1030 * MS, 12, 20)


def test_counters_far_apart_do_not_belong_together():
    pairs = TickPairs()
    pairs.add("left", 1000 * MS, 10)
    assert pairs.add("right", 2000 * MS, 20) is None
    assert pairs.add("left", 2010 * MS, 30) == (2010 * MS, 30, 20)


def test_a_first_counter_that_was_missed_does_not_shift_all_pairs():
    pairs = TickPairs()
    stamps = [("right", 2), ("left", 20), ("right", 22), ("left", 40), ("right", 42), ("left", 60), ("right", 62)]
    found = [pairs.add(side, stamp * MS, stamp) for side, stamp in stamps]
    assert found == [None, (20 * MS, 20, 2), None, None, (42 * MS, 40, 42), None, (62 * MS, 60, 62)]


def test_counters_of_which_no_partner_came_are_counted():
    pairs = TickPairs()
    for stamp in range(3):
        pairs.add("left", stamp * MS, stamp)
    assert pairs.unpaired == 2
