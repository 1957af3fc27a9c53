# SPDX-License-Identifier: BSD-3-Clause
import numpy as np

from ceiling_dso_ros.dso import DirectOdometry, TrackingState
from ceiling_dso_ros.dso.config import OdometryConfig, WindowConfig
from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.dso.warmup import textured_plane

CAMERA = PinholeCamera(200.0, 200.0, 159.5, 119.5, 320, 240)
WINDOW = WindowConfig(max_keyframes=3, min_keyframes=2, candidate_points=300, active_points=400)


def test_no_points_before_the_first_map():
    odometry = DirectOdometry(CAMERA)
    assert odometry.map is None


def test_points_lie_on_the_surface_that_is_seen():
    """The surface's depth varies by a fifth around one unit, which initialisation makes about the unit of length."""
    odometry = DirectOdometry(CAMERA, OdometryConfig(window=WINDOW))
    for frame in range(80):
        status = odometry.track(textured_plane(CAMERA, 0.012 * frame), frame * 10**9)
        if status.state is TrackingState.TRACKING and frame > 40:
            break
    points = odometry.map.points
    assert len(points.positions) == status.active_points
    assert len(points.grey) == len(points.positions)
    depths = points.positions[:, 2]  # the camera moves sideways, so its z axis is the world's
    assert 0.6 < np.median(depths) < 1.6
    assert np.percentile(depths, 90) / np.percentile(depths, 10) < 2.0
