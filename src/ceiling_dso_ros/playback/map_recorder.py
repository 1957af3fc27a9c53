# SPDX-License-Identifier: BSD-3-Clause
"""Collects the points of the odometry's map into a point cloud."""

from typing import Dict, List, Mapping

import numpy as np

from ceiling_dso_ros.dso import HostedPoints, KeyframeEstimate, OdometryStatus
from ceiling_dso_ros.dso.hosted_points import NO_HOSTED_POINTS
from ceiling_dso_ros.io.ply import PointCloud


class MapRecorder:
    """Stores the marginalised points and those of each segment's last window, 36 bytes per point."""

    def __init__(self) -> None:
        self._marginalized: List[HostedPoints] = []
        self._windows: Dict[int, HostedPoints] = {}  # of each segment

    def add(self, status: OdometryStatus) -> None:
        """Add the result of one frame; frames must be in the order of time."""
        if not status.keyframes:
            return
        self._marginalized.append(status.marginalized)
        self._windows[status.segment] = status.window_points

    def cloud(self, keyframes: Mapping[int, KeyframeEstimate]) -> PointCloud:
        """The points so far, at the given poses of their hosts.

        Args:
            keyframes: keyframe_id -> its estimate, for all keyframes in any status.

        Raises:
            KeyError: the estimate of a host is missing.
        """
        parts = [NO_HOSTED_POINTS, *self._marginalized, *self._windows.values()]
        points = HostedPoints.concatenated(parts)
        poses = {keyframe_id: keyframe.T_world_camera for keyframe_id, keyframe in keyframes.items()}
        positions = np.concatenate([part.positions_world(poses) for part in parts])
        hosts, index = np.unique(points.keyframe_id, return_inverse=True)
        segments = np.array([keyframes[host].segment for host in hosts.tolist()], np.int64)
        return PointCloud(positions, points.grey, segments[index], points.keyframe_id)
