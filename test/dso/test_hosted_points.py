# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.dso import HostedPoints
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.hosted_points import NO_HOSTED_POINTS

POINTS = HostedPoints(
    np.array([7, 3, 7]), np.array([[0.0, 0.0, 1.0], [0.5, 0.0, 2.0], [0.0, 0.2, 4.0]]), np.array([1, 2, 3], np.float32)
)


def test_points_follow_their_hosts():
    turned = se3.exp(np.array([0, 0, 0, 0, 0, np.pi / 2]))
    turned[:3, 3] = [1.0, 2.0, 3.0]
    positions = POINTS.positions_world({3: turned, 5: np.full((4, 4), np.nan), 7: np.eye(4)})
    np.testing.assert_allclose(positions, [[0.0, 0.0, 1.0], [1.0, 2.5, 5.0], [0.0, 0.2, 4.0]], atol=1e-12)


def test_a_host_without_a_pose_is_refused():
    with pytest.raises(KeyError, match="3"):
        POINTS.positions_world({7: np.eye(4)})


def test_parts_are_put_together_in_their_order():
    both = HostedPoints.concatenated([POINTS, NO_HOSTED_POINTS, POINTS])
    assert both.keyframe_id.tolist() == [7, 3, 7, 7, 3, 7]
    assert both.position_camera.shape == (6, 3)
    assert both.grey.tolist() == [1, 2, 3, 1, 2, 3]
    assert both.grey.dtype == np.float32
    assert len(HostedPoints.concatenated([])) == 0
    assert NO_HOSTED_POINTS.positions_world({}).shape == (0, 3)
