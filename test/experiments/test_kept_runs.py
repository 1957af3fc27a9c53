# SPDX-License-Identifier: BSD-3-Clause
"""Results that are kept in a folder, which may come from anywhere."""

import pickle

import numpy as np
import pytest

from ceiling_dso_ros.dso import KeyframeEstimate, OdometryStatus, TrackingState
from ceiling_dso_ros.dso.hosted_points import HostedPoints
from ceiling_dso_ros.experiments.kept_runs import Kept


class RunsCode:
    def __reduce__(self):
        return open, ("pwned", "w")


class Recording:
    """Is not tracked, because there is a result."""


def statuses():
    points = HostedPoints(np.zeros(2, np.int64), np.ones((2, 3)), np.ones(2, np.float32))
    keyframe = KeyframeEstimate(3, 17, 0, np.eye(4), (np.float64(0.5), 1.0), False)
    whole = OdometryStatus(
        17,
        TrackingState.TRACKING,
        0,
        np.eye(4),
        np.eye(6),
        True,
        3,
        np.eye(4),
        (keyframe,),
        points,
        points,
        1.5,
        5,
        7,
        {"all": 1.0},
    )
    return whole, OdometryStatus(18, TrackingState.LOST, 1, message="dark")


def test_results_come_back(tmp_path):
    (tmp_path / "drive.pickle").write_bytes(pickle.dumps(("another version", statuses())))
    back = Kept(tmp_path).statuses(Recording(), "drive")
    assert [status.state for status in back] == [TrackingState.TRACKING, TrackingState.LOST]
    np.testing.assert_array_equal(back[0].keyframes[0].T_world_camera, np.eye(4))
    assert back[0].window_points.grey.dtype == np.float32


@pytest.mark.parametrize(
    "content", [RunsCode(), ("version", (RunsCode(),)), ("version", (np.testing.assert_allclose,))]
)
def test_a_file_that_would_run_code_is_refused(tmp_path, monkeypatch, content):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "drive.pickle").write_bytes(pickle.dumps(content))
    with pytest.raises(pickle.UnpicklingError, match="is no part of a result"):
        Kept(tmp_path).statuses(Recording(), "drive")
    assert not (tmp_path / "pwned").exists()
