# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

pytest.importorskip("ceiling_dso_ros.msg", reason="needs ROS and the built workspace")
pytestmark = pytest.mark.ros

from std_msgs.msg import Header  # noqa: E402

from ceiling_dso_ros.dso import OdometryStatus, PinholeCamera, TrackingState  # noqa: E402
from ceiling_dso_ros.dso.mapping.map_snapshot import MapPoints  # noqa: E402
from ceiling_dso_ros.ros.map_publisher import draw_points, point_cloud  # noqa: E402

CAMERA = PinholeCamera(50.0, 50.0, 63.5, 47.5, 128, 96)
POINTS = MapPoints(np.array([[0.0, 0.0, 1.0], [0.2, 0.1, 2.0], [0.0, 0.0, -1.0]]), np.array([10.0, 20.0, 30.0]))


def test_point_cloud_holds_positions_and_grey_levels():
    cloud = point_cloud(Header(frame_id="vo"), POINTS)
    table = np.frombuffer(cloud.data, np.float32).reshape(-1, 4)
    np.testing.assert_allclose(table, np.column_stack([POINTS.positions, POINTS.grey]), rtol=1e-6)
    assert (cloud.width, cloud.row_step, cloud.header.frame_id) == (3, 48, "vo")


def test_points_are_drawn_where_the_camera_sees_them():
    T = np.eye(4)
    T[0, 3] = 0.1  # the camera has moved to the right: points are seen further left
    status = OdometryStatus(1.0, TrackingState.TRACKING, 0, T_world_camera=T)
    plain = np.full((96, 128), 100.0, np.float32)
    drawn = draw_points(plain, CAMERA, status, POINTS).astype(int)
    coloured = drawn.max(axis=2) - drawn.min(axis=2) > 50
    for u, v in ((63.5 - 5.0, 47.5), (63.5 + 2.5, 47.5 + 2.5)):
        assert coloured[round(v), round(u)]
    assert not coloured[60:].any()


def test_without_a_pose_nothing_is_drawn_but_the_reason():
    status = OdometryStatus(1.0, TrackingState.LOST, 0, message="dark")
    drawn = draw_points(np.zeros((96, 128), np.float32), CAMERA, status, MapPoints(np.zeros((0, 3)), np.zeros(0)))
    assert drawn.shape == (96, 128, 3)
    assert not drawn[30:].any()
