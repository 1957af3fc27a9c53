# SPDX-License-Identifier: BSD-3-Clause
"""Times add up per stage, also when a stage fails."""

import pytest

from ceiling_dso_ros.dso.compute.stage_timer import StageTimer


def test_stages_add_up():
    timer = StageTimer()
    with timer.stage("a"):
        pass
    first = timer.timing_ms["a"]
    with timer.stage("a"), timer.stage("b"):
        pass
    assert list(timer.timing_ms) == ["a", "b"]
    assert timer.timing_ms["a"] > first >= 0


def test_a_stage_that_fails_is_counted():
    timer = StageTimer()
    with pytest.raises(RuntimeError), timer.stage("a"):
        raise RuntimeError
    assert timer.timing_ms["a"] >= 0
