# SPDX-License-Identifier: BSD-3-Clause
"""Measures the scale of the window's keyframes, by the images of the second camera.

A keyframe is measured once, when it is made. After that the bundle adjustment goes on refining poses and depths, and
with them their unit: in a young map by several percent. What was measured follows, by the ratio of the inverse depths
that the same points have in the keyframe before and after. So it fits the keyframe as last refined.
"""

import math
from typing import Dict, Optional, Tuple

import numpy as np

from ceiling_dso_ros.dso.config import RigConfig
from ceiling_dso_ros.dso.geometry.projection import intrinsic_matrix
from ceiling_dso_ros.dso.images.frame import Frame
from ceiling_dso_ros.dso.status import NO_SCALE, ScaleMeasurement
from ceiling_dso_ros.dso.stereo.rig import StereoRig
from ceiling_dso_ros.dso.stereo.scale import LEAST_POINTS
from ceiling_dso_ros.dso.stereo.scale_finder import ScaleFinder, SeenPoints
from ceiling_dso_ros.dso.window.keyframe_window import KeyframeWindow
from ceiling_dso_ros.dso.window.pair_geometry import PairGeometry, pair_geometry, project_points
from ceiling_dso_ros.dso.window.visible_points import visible_points


class WindowScale:
    """Measures the scale keyframe by keyframe, for one segment."""

    def __init__(self, rig: StereoRig, config: RigConfig) -> None:
        self._finder = ScaleFinder(rig, config)
        # Of the keyframes of the window by their ids: names of the points, sorted, and their inverse depths in it.
        self._depths: Dict[int, Tuple[np.ndarray, np.ndarray]] = {}
        self._log_scale = math.nan  # of the newest keyframe that was measured, as last refined

    def update(self, window: KeyframeWindow, frame: Frame) -> None:
        """Have the measured scales follow the refined window, and measure its newest keyframe, that of a frame."""
        pairs = pair_geometry(window.keyframes, window.count, window.intrinsics)
        names = _names(window)
        order = np.argsort(names)
        before, self._depths = self._depths, {}
        for slot, keyframe_id in enumerate(window.ids):
            now = names[order], _inverse_depths(window, pairs, slot)[order]
            self._depths[keyframe_id] = now
            scale = window.scales[slot]
            if keyframe_id in before and math.isfinite(scale.log_scale):
                followed = scale.log_scale + _log_ratio(before[keyframe_id], now)
                window.scales[slot] = scale._replace(log_scale=followed)
                self._log_scale = followed
        measured = self._measure(window, frame, names)
        window.scales[window.newest] = measured
        if math.isfinite(measured.log_scale):
            self._log_scale = measured.log_scale

    def _measure(self, window: KeyframeWindow, frame: Frame, names: np.ndarray) -> ScaleMeasurement:
        right = None if frame.right is None else frame.right()
        if right is None:
            return NO_SCALE
        seen = visible_points(window)
        points = SeenPoints(seen.u, seen.v, seen.idepth, names[seen.number])
        left = window.image(window.newest).reshape(window.height, window.width)
        K = intrinsic_matrix(window.intrinsics)
        known: Optional[float] = math.exp(self._log_scale) if math.isfinite(self._log_scale) else None
        return self._finder.measure(left, K, right, frame.smooth, points, known)


def _names(window: KeyframeWindow) -> np.ndarray:
    """(n,) int64 identities of the active points: host keyframe and pixel, which never change."""
    points, count = window.points.arrays, window.points.count
    host = np.array(window.ids, np.int64)[points.host[:count]]
    return (host << 32) + (points.v[:count].astype(np.int64) << 16) + points.u[:count].astype(np.int64)


def _inverse_depths(window: KeyframeWindow, pairs: PairGeometry, slot: int) -> np.ndarray:
    """(n,) float32 of the active points in a keyframe, 1/unit."""
    points, count = window.points.arrays, window.points.count
    x, y, idepth = (np.empty(count, np.float32) for _ in range(3))
    project_points(
        points.u[:count], points.v[:count], points.idepth[:count], points.host[:count], pairs, slot, x, y, idepth
    )
    return idepth


def _log_ratio(before: Tuple[np.ndarray, np.ndarray], now: Tuple[np.ndarray, np.ndarray]) -> float:
    """Logarithm of how much larger the inverse depths of the same points are now; 0 where there are too few."""
    _, old, new = np.intersect1d(before[0], now[0], assume_unique=True, return_indices=True)
    old_idepth, new_idepth = before[1][old], now[1][new]
    good = (old_idepth > 0.0) & (new_idepth > 0.0)
    if np.count_nonzero(good) < LEAST_POINTS:
        return 0.0
    return float(np.median(np.log(new_idepth[good].astype(np.float64) / old_idepth[good])))
