# SPDX-License-Identifier: BSD-3-Clause
"""A small part of `scripts/bench fuzz` for the nodes, always with the same messages."""

import pytest

pytest.importorskip("ceiling_dso_ros.msg", reason="needs ROS and the built workspace")
pytestmark = [pytest.mark.ros, pytest.mark.long]

from support.fuzzing import handlers  # noqa: E402
from support.fuzzing.runner import run  # noqa: E402

INPUTS = 12  # of each target; the first of a full run


def test_wrong_messages_break_no_rule(tmp_path):
    with handlers.without_a_master(tmp_path) as targets:
        outcomes = [run(target, 0, INPUTS) for target in targets]
        assert sum(target.count for target in targets) > 8_000
    assert [(each.name, failure.shown, failure.why) for each in outcomes for failure in each.failures] == []
    assert 0 < sum(each.used for each in outcomes) < sum(each.inputs for each in outcomes)
