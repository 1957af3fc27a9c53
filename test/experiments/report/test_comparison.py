# SPDX-License-Identifier: BSD-3-Clause
"""Two studies: what is said where nothing has changed, and where something has."""

import pytest

from ceiling_dso_ros.cli.main import main
from ceiling_dso_ros.experiments.report.comparison import compare
from ceiling_dso_ros.io.errors import InputError

GRID = {"fps": ["15", "30"]}


def test_a_version_against_itself_with_other_seeds_finds_nothing(made_up):
    first = made_up("before", GRID, seeds=4)
    for number in range(1, 21):
        comparison = compare(first, made_up("after", GRID, seeds=4, first_seed=10 * number))
        assert not comparison.is_worse, str(comparison)
        assert {each.verdict for each in comparison.measures} <= {"no change", "unknown"}


def test_the_very_same_runs_have_not_changed(made_up):
    comparison = compare(made_up("before", GRID), made_up("after", GRID))
    assert {each.change.ratio for each in comparison.measures if each.change} == {1.0}
    assert not comparison.is_worse


def test_a_known_change_is_found(made_up, capsys):
    before, after = made_up("before", GRID, seeds=4), made_up("after", GRID, seeds=4, first_seed=10, factor=2.0)
    ate = compare(before, after).measures[0]
    assert ate.verdict == "WORSE"
    assert 1.3 < ate.change.low < 2.0 < ate.change.high < 3.0
    assert compare(after, before).measures[0].verdict == "better"
    with pytest.raises(SystemExit) as end:
        main(["compare", str(before.folder), str(after.folder)])
    assert end.value.code == 1
    assert "verdict: WORSE" in capsys.readouterr().out
    assert main(["compare", str(after.folder), str(before.folder)]) == 0


def test_a_run_that_fails_now_is_worse(made_up):
    comparison = compare(made_up("before", GRID), made_up("after", GRID, failing=(2,)))
    assert comparison.is_worse
    assert comparison.failed == [f"{2:016x}"]


def test_nothing_in_common(made_up):
    with pytest.raises(InputError, match="no run of one has"):
        compare(made_up("before", {"fps": ["15"]}), made_up("after", {"fps": ["30"]}))
