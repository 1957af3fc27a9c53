# SPDX-License-Identifier: BSD-3-Clause
"""The points of the window that its newest keyframe sees."""

from typing import NamedTuple

import numpy as np

from ceiling_dso_ros.dso.window.keyframe_window import KeyframeWindow
from ceiling_dso_ros.dso.window.pair_geometry import pair_geometry, project_points
from ceiling_dso_ros.dso.window.points import INLIER


class VisiblePoints(NamedTuple):
    """Points that are inliers in the newest keyframe, as seen from there.

    Attributes:
        number: (n,) int64 of each in the table of the points.
        u, v: (n,) float32 pixels.
        idepth: (n,) float32 inverse depths, 1/unit.
    """

    number: np.ndarray
    u: np.ndarray
    v: np.ndarray
    idepth: np.ndarray


def visible_points(window: KeyframeWindow) -> VisiblePoints:
    """Project the points into the newest keyframe."""
    newest, count = window.newest, window.points.count
    points = window.points.arrays
    visible = np.flatnonzero(
        (window.points.residuals.live[newest, :count] > 0) & (window.points.residuals.state[newest, :count] == INLIER)
    )
    pairs = pair_geometry(window.keyframes, window.count, window.intrinsics)
    x, y, idepth = (np.empty(visible.size, np.float32) for _ in range(3))
    project_points(
        points.u[visible], points.v[visible], points.idepth[visible], points.host[visible], pairs, newest, x, y, idepth
    )
    return VisiblePoints(visible, x, y, idepth)
