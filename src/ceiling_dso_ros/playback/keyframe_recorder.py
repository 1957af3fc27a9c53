# SPDX-License-Identifier: BSD-3-Clause
"""Collects what a map needs of the keyframes: image and points when they leave the odometry's window."""

from typing import Dict, List, Sequence, Tuple

import numpy as np

from ceiling_dso_ros.dso import HostedPoints, KeyframeEstimate, OdometryStatus
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.dso.geometry.projection import Intrinsics, pixels
from ceiling_dso_ros.dso.hosted_points import NO_HOSTED_POINTS
from ceiling_dso_ros.slam.records import KeyframeView

RECENT_IMAGES = 30  # among which a keyframe's own is looked for


class KeyframeRecorder:
    """Makes a `KeyframeView` of each keyframe that leaves the window."""

    def __init__(self, camera: PinholeCamera) -> None:
        """Begin; the camera is that of the undistorted images."""
        self.camera = camera
        self._images: Dict[int, np.ndarray] = {}  # by stamp: recent ones, and those of the window
        self._keyframes: Tuple[KeyframeEstimate, ...] = ()
        self._points: Dict[int, List[HostedPoints]] = {}  # marginalised points of each host in the window
        self._window_points = NO_HOSTED_POINTS

    def add(self, image: np.ndarray, status: OdometryStatus) -> List[KeyframeView]:
        """Add an image, (height, width) float32 and undistorted, with its result; returns those that have left."""
        self._images[status.stamp_ns] = image
        left: List[KeyframeView] = []
        if status.keyframes:
            if self._keyframes and status.segment != self._keyframes[0].segment:
                left += self._leave(self._keyframes)
            left += self._take_in(status)
        self._forget_images(status)
        return left

    def _take_in(self, status: OdometryStatus) -> List[KeyframeView]:
        self._keyframes, self._window_points = status.keyframes, status.window_points
        known = {keyframe.keyframe_id for keyframe in status.keyframes}
        self._points = {host: parts for host, parts in self._points.items() if host in known}
        for host in np.unique(status.marginalized.keyframe_id).tolist():
            chosen = status.marginalized.keyframe_id == host
            self._points.setdefault(host, []).append(status.marginalized.chosen(chosen))
        left = self._leave([keyframe for keyframe in status.keyframes if keyframe.leaves])
        self._keyframes = tuple(keyframe for keyframe in status.keyframes if not keyframe.leaves)
        return left

    def _leave(self, leaving: Sequence[KeyframeEstimate]) -> List[KeyframeView]:
        """Make views of keyframes; the points of all that were in the window with them are used where they see them."""
        if not leaving:
            return []
        views = []
        window = {keyframe.keyframe_id: keyframe.T_world_camera for keyframe in (*self._keyframes, *leaving)}
        parts = [self._window_points, *(part for host in sorted(self._points) for part in self._points[host])]
        points = HostedPoints.concatenated(parts)
        points = points.chosen(np.isin(points.keyframe_id, list(window)))
        positions = points.positions_world(window)
        for keyframe in leaving:
            image = self._images.get(keyframe.stamp_ns)
            if image is None:
                continue
            T = se3.inverse(keyframe.T_world_camera)
            seen = _in_view(positions @ T[:3, :3].T + T[:3, 3], self.camera)
            views.append(KeyframeView.of(keyframe.stamp_ns, keyframe.keyframe_id, image, self.camera, seen))
        return views

    def _forget_images(self, status: OdometryStatus) -> None:
        wanted = {keyframe.stamp_ns for keyframe in self._keyframes} | {status.predict_from_ns}
        recent = sorted(self._images)[-RECENT_IMAGES:]
        self._images = {stamp_ns: self._images[stamp_ns] for stamp_ns in {*recent, *(wanted & set(self._images))}}


def _in_view(points: np.ndarray, camera: PinholeCamera) -> np.ndarray:
    """Those of (N, 3) points that the camera sees."""
    ahead = points[points[:, 2] > 0.0]
    u, v = pixels(Intrinsics(*camera.parameters), *(ahead[:, :2] / ahead[:, 2:]).T)
    return ahead[(u >= 0) & (u <= camera.width - 1) & (v >= 0) & (v <= camera.height - 1)]
