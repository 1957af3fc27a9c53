# SPDX-License-Identifier: BSD-3-Clause
"""Which frames become keyframes, and which keyframes and points leave the window."""

from typing import List

import numpy as np

from ceiling_dso_ros.dso.config import KeyframeConfig, OptimizationConfig, WindowConfig
from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.dso.tracking.frame_tracker import TrackedFrame
from ceiling_dso_ros.dso.tracking.tracking_reference import TrackingReference
from ceiling_dso_ros.dso.window.keyframe_window import KeyframeWindow
from ceiling_dso_ros.dso.window.points import INLIER, OUT_OF_BOUNDS, OUTLIER

MIN_POINTS_LEFT = 0.05  # share of the active points that a keyframe ever had
KEPT_NEWEST = 2  # of the older ones: their candidates have hardly had a chance to become points
SURPRISING_SHARE = 0.25  # of the points, that nothing explains in a frame, more than in the one before


def brightness_change(affine: np.ndarray, exposure: float, reference: TrackingReference) -> float:
    """|ln alpha| between a frame and the reference keyframe."""
    return abs(float(affine[0] - reference.affine[0]) + np.log(exposure / reference.exposure))


class KeyframeTrigger:
    """Decides which tracked frames become keyframes: those that have moved, or changed, enough.

    Not one of which suddenly a part shows something else: if that lasts, the next frame becomes one.
    """

    def __init__(self, camera: PinholeCamera, config: KeyframeConfig) -> None:
        self._config = config
        self._flow_unit = camera.width + camera.height  # pixels; makes the number of keyframes independent of the size
        self._first_rmse = np.inf
        self._saturated = 1.0  # of the last frame

    def renew(self) -> None:
        """Start with another reference; later errors are compared with the error of the next frame."""
        self._first_rmse = np.inf

    def fires(self, tracked: TrackedFrame, exposure: float, reference: TrackingReference) -> bool:
        """Whether a frame that was tracked against the reference is to become a keyframe."""
        if not np.isfinite(self._first_rmse):
            self._first_rmse = tracked.rmse
        before, self._saturated = self._saturated, tracked.saturated
        if tracked.saturated > before + SURPRISING_SHARE:
            return False
        motion_flow = np.sqrt(tracked.motion_flow)
        if motion_flow > self._config.min_flow and tracked.rmse > self._config.max_rmse_growth * self._first_rmse:
            return True
        score = self._config.translation_weight * np.sqrt(tracked.translation_flow) / self._flow_unit
        score += self._config.motion_weight * motion_flow / self._flow_unit
        score += self._config.brightness_weight * brightness_change(tracked.affine, exposure, reference)
        return bool(score > 1.0)


def keyframes_to_marginalize(window: KeyframeWindow, position: np.ndarray, config: WindowConfig) -> List[int]:
    """Slots that leave when a keyframe is added: nearly empty ones, then the least useful.

    A keyframe of another brightness stays (the published method removes it): its points still tell the unit of length,
    which changed where lamps went out and most of the window was removed at once.

    Args:
        position: (3,) of the new keyframe in the world.
    """
    n = window.count
    flagged: List[int] = []
    points = np.diff(window.points.host_ranges(n))
    for slot in range(n - KEPT_NEWEST):
        if n - len(flagged) < config.min_keyframes:
            break
        if points[slot] < MIN_POINTS_LEFT * (points[slot] + window.gone_points[slot]):
            flagged.append(slot)
    if n - len(flagged) >= config.max_keyframes:
        flagged.append(least_useful(window, position))
    return sorted(set(flagged))


def least_useful(window: KeyframeWindow, position: np.ndarray) -> int:
    """The slot, not the newest, far from the new keyframe and close to others, so that the rest stays spread out."""
    older = window.count - 1
    positions = np.array([window.T_world_camera(slot)[:3, 3] for slot in range(older)])
    closeness = 1.0 / (1e-5 + np.linalg.norm(positions[:, None] - positions[None], axis=2))
    np.fill_diagonal(closeness, 0.0)
    scores = np.sqrt(np.linalg.norm(positions - position, axis=1)) * closeness.sum(axis=1)
    return int(np.argmax(scores))


class PointFate:
    """Which active points leave after the bundle adjustment, and how.

    Attributes:
        marginalize: (points,) bool, removed, with their information added to the prior.
        drop: (points,) bool, removed without their information.
    """

    def __init__(self, window: KeyframeWindow, leaving: List[int], config: OptimizationConfig) -> None:
        count = window.points.count
        points, residuals = window.points.arrays, window.points.residuals
        state = residuals.state[: window.count, :count]
        live = residuals.live[: window.count, :count] > 0
        number = live.sum(axis=0)
        host = points.host[:count]
        newest = np.where(host == window.newest, INLIER, state[window.newest])
        previous = np.where(host == window.newest - 1, INLIER, state[max(window.newest - 1, 0)])
        invisible = (newest == OUT_OF_BOUNDS) | ((newest == OUTLIER) & (previous == OUTLIER))
        goes = invisible | np.isin(host, leaving)
        hopeless = (points.idepth[:count] < 0) | (number == 0)
        informative = (
            (points.good_residuals[:count] >= config.point_min_good_residuals)
            & (number >= config.point_min_live_residuals)
            & (points.idepth_hessian[:count] > config.point_min_hessian)
        )
        self.marginalize = goes & informative & ~hopeless
        self.drop = (goes | hopeless) & ~self.marginalize
