from ceiling_dso_ros.ros.tick_pairs import TickPairs


def test_both_counters_once_they_are_there():
    pairs = TickPairs()
    assert pairs.add("left", 1.00, 10) is None
    assert pairs.add("right", 1.01, 20) == (1.01, 10, 20)
    assert pairs.add("right", 1.02, 21) is None
    assert pairs.add("left", 1.03, 11) == (1.03, 11, 21)


def test_the_newest_counter_counts():
    pairs = TickPairs()
    pairs.add("left", 1.00, 10)
    pairs.add("left", 1.02, 12)
    assert pairs.add("right", 1.03, 20) == (1.03, 12, 20)


def test_counters_far_apart_do_not_belong_together():
    pairs = TickPairs()
    pairs.add("left", 1.0, 10)
    assert pairs.add("right", 2.0, 20) is None
    assert pairs.add("left", 2.01, 30) == (2.01, 30, 20)
