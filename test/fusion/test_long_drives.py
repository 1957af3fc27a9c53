# SPDX-License-Identifier: BSD-3-Clause
"""Long drives: no false reports of slip, and nothing that grows with time."""

import pytest

pytestmark = pytest.mark.long(minutes=10)


def test_ten_minutes_without_slip_have_at_most_one_false_report(simulate, fuse, robot_truth):
    fused = fuse(simulate("loops", 600.0, 11, robot_truth), keep_history=False)
    assert len(fused.estimator.slips) <= 1
    assert fused.ate(fused.stamps, fused.poses) < 0.003 * fused.drive.path_m


def test_what_it_remembers_does_not_grow(simulate, fuse, robot_truth):
    estimator = fuse(simulate("loops", 120.0, 12, robot_truth), keep_history=False).estimator
    backend = estimator._backend
    assert len(backend._graph.intervals) == estimator.config.graph.window
    assert backend._graph.history is None
    assert backend._graph._values.size() <= 2 * (estimator.config.graph.window + 1)
    assert len(estimator._waiting) <= 2
    assert len(estimator._frames) <= 60
    assert len(estimator._track.steps(0, 2**62)) <= 502
