# SPDX-License-Identifier: BSD-3-Clause
"""Measures the scale of the window's newest keyframe, by the image of the second camera."""

import numpy as np

from ceiling_dso_ros.dso.config import RigConfig
from ceiling_dso_ros.dso.geometry.projection import intrinsic_matrix
from ceiling_dso_ros.dso.images.frame import Frame
from ceiling_dso_ros.dso.stereo.rig import StereoRig
from ceiling_dso_ros.dso.stereo.scale import NO_SCALE, ScaleMeasurement
from ceiling_dso_ros.dso.stereo.scale_finder import ScaleFinder, SeenPoints
from ceiling_dso_ros.dso.window.keyframe_window import KeyframeWindow
from ceiling_dso_ros.dso.window.visible_points import visible_points


class WindowScale:
    """Measures the scale keyframe by keyframe, for one segment."""

    def __init__(self, rig: StereoRig, config: RigConfig) -> None:
        self._finder = ScaleFinder(rig, config)

    def measure(self, window: KeyframeWindow, frame: Frame) -> ScaleMeasurement:
        """Metres per unit at the newest keyframe, that of a frame; NO_SCALE where the images do not tell it."""
        right = None if frame.right is None else frame.right()
        if right is None:
            return NO_SCALE
        number, u, v, idepth = visible_points(window)
        points = window.points.arrays
        host = np.array(window.ids, np.int64)[points.host[number]]
        name = (host << 32) + (points.v[number].astype(np.int64) << 16) + points.u[number].astype(np.int64)
        left = window.image(window.newest).reshape(window.height, window.width)
        K = intrinsic_matrix(window.intrinsics)
        return self._finder.measure(left, K, right, frame.smooth, SeenPoints(u, v, idepth, name))
