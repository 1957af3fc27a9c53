# SPDX-License-Identifier: BSD-3-Clause
import numpy as np

from ceiling_dso_ros.fusion.state import FusedState, FusionState, ScaleState
from ceiling_dso_ros.playback.fused_record import FusedRecord, smoothed_trajectory


def test_trajectories_hold_every_output():
    record = FusedRecord()
    scale = ScaleState(1.0, 0.1, True, 0)
    for index in range(3):
        pose = np.array([index, 0.0, 0.5])
        state = FusedState(10**18 + index, pose, np.eye(3), np.zeros(2), np.eye(2), FusionState.CONVERGED, (), scale)
        record.add(state, pose + 1.0)
    assert record.fused().positions[:, 0].tolist() == [0.0, 1.0, 2.0]
    assert record.wheel().positions[:, 1].tolist() == [1.0, 1.0, 1.0]
    assert record.fused().stamps_ns.tolist() == [10**18, 10**18 + 1, 10**18 + 2]


def test_nothing_yet():
    assert len(FusedRecord().fused()) == len(FusedRecord().wheel()) == len(smoothed_trajectory([])) == 0


def test_a_trajectory_that_somebody_still_has_does_not_stop_the_record():
    """A service writes its files while wheel samples go on."""
    record = FusedRecord()
    scale = ScaleState(1.0, 0.1, True, 0)
    kept = []
    for index in range(3):
        state = FusedState(index, np.zeros(3), np.eye(3), np.zeros(2), np.eye(2), FusionState.CONVERGED, (), scale)
        record.add(state, np.zeros(3))
        kept.append(record.fused())
    assert [len(fused) for fused in kept] == [1, 2, 3]
