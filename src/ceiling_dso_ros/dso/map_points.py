"""The map as others may see it: the window's active points in the world."""

from typing import NamedTuple

import numpy as np

from ceiling_dso_ros.dso.odometry import DirectOdometry


class MapPoints(NamedTuple):
    """Points with a positive inverse depth.

    Attributes:
        positions: (N, 3) float64 in the VO world, VO units.
        grey: (N,) float32 grey level in the keyframe that hosts the point.
    """

    positions: np.ndarray
    grey: np.ndarray


def map_points(odometry: DirectOdometry) -> MapPoints:
    """The active points as they stand after the last image; none before the first map."""
    window = odometry.window
    arrays, count = window.points.arrays, window.points.count
    idepth = arrays.idepth[:count].astype(np.float64)
    front = idepth > 0.0
    fx, fy, cx, cy = window.intrinsics
    rays = np.column_stack([(arrays.u[:count] - cx) / fx, (arrays.v[:count] - cy) / fy, np.ones(count)])[front]
    in_host = rays / idepth[front, None]
    host = arrays.host[:count][front]
    positions = np.empty((len(in_host), 3))
    for slot in range(window.count):
        own = host == slot
        T = window.T_world_camera(slot)
        positions[own] = in_host[own] @ T[:3, :3].T + T[:3, 3]
    return MapPoints(positions, arrays.grey[:, :count].mean(axis=0)[front])
