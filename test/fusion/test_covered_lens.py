# SPDX-License-Identifier: BSD-3-Clause
"""What a covered lens costs: not more than the wheels alone drift meanwhile."""

import dataclasses

import numpy as np
import pytest

from ceiling_dso_ros.dso.durations import seconds
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.state import FusionState

pytestmark = pytest.mark.long


@pytest.mark.parametrize("seed", range(5))
def test_a_lens_covered_for_five_seconds(simulate, fuse, robot_truth, seed):
    covered = dataclasses.replace(robot_truth, losses=((25.0, 30.0),))
    drive = simulate("loops", 60.0, seed, covered)
    fused = fuse(drive)
    clear = fuse(simulate("loops", 60.0, seed, robot_truth))
    states = {s.state for s in fused.states if 25.1 < seconds(s.stamp_ns - drive.stamps[0]) < 29.9}
    assert states == {FusionState.DEGRADED}
    added = np.hypot(*(fused.poses[-1] - clear.poses[-1])[:2])
    first, last = np.searchsorted(fused.times_s, [25.0, 30.0])
    start, end, finish = fused.truth(fused.stamps[[first, last, -1]])
    drifted = planar.compose(start, planar.between(*fused.wheel_poses[[first, last]]))
    assert added < np.hypot(*(planar.compose(drifted, planar.between(end, finish)) - finish)[:2])
