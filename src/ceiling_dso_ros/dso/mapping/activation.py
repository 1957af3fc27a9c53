# SPDX-License-Identifier: BSD-3-Clause
"""Activation: where points are missing, candidates with a narrow depth interval become active points."""

from typing import Tuple

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel
from ceiling_dso_ros.dso.config import ActivationConfig
from ceiling_dso_ros.dso.mapping.activation_kernels import refine_idepths, spread, stamp_distance
from ceiling_dso_ros.dso.window import trace_outcome
from ceiling_dso_ros.dso.window.candidates import UNSEARCHED_QUALITY
from ceiling_dso_ros.dso.window.keyframe_window import KeyframeWindow
from ceiling_dso_ros.dso.window.pair_geometry import PairGeometry, pair_geometry, project_points

MAX_SPACING = 4.0  # half-resolution pixels
LARGEST_KIND = 4
FAR = np.int32(1 << 30)


@kernel
def stamp_all(distance2: np.ndarray, x: np.ndarray, y: np.ndarray, reach: int) -> None:
    """Mark points on a distance map."""
    height, width = distance2.shape
    for i in range(x.size):
        column, row = int(x[i] + np.float32(0.5)), int(y[i] + np.float32(0.5))
        if 0 <= column < width and 0 <= row < height:
            stamp_distance(distance2, column, row, reach)


class Activator:
    """Keeps the number of active points near the wanted one by adapting their minimum spacing."""

    def __init__(self, window: KeyframeWindow, wanted: int, config: ActivationConfig) -> None:
        self.config = config
        self.wanted = wanted
        self._distance2 = np.zeros(((window.height + 1) // 2, (window.width + 1) // 2), np.int32)
        self.begin()

    def begin(self) -> None:
        """Be ready for the first keyframe of a map."""
        self.spacing = 2.0  # half-resolution pixels between active points

    def activate(self, window: KeyframeWindow) -> int:
        """Move narrow candidates to the window's points and drop those that failed; returns the number moved."""
        self._adapt_spacing(window.points.count)
        pairs = pair_geometry(window.keyframes, window.count, window.intrinsics)
        eligible = self._eligible(window)
        chosen = eligible[self._spread(window, pairs, eligible)]
        candidates = window.candidates.arrays
        idepths = 0.5 * (candidates.idepth_min[chosen] + candidates.idepth_max[chosen])
        ranges = np.searchsorted(candidates.host[chosen], np.arange(window.count + 1))
        inliers = np.zeros((window.keyframes.offset.shape[0], chosen.size), np.uint8)
        inliers[: window.count] = refine_idepths(
            candidates.u[chosen], candidates.v[chosen], candidates.grey[:, chosen], candidates.weight[:, chosen],
            idepths, ranges, window.pool.buffers, window.width, window.height, window.keyframes, pairs,
            self.config.iterations, self.config.min_hessian,
        )  # fmt: skip
        good = np.isfinite(idepths)
        ripe = chosen[good]
        window.points.append(
            candidates.u[ripe], candidates.v[ripe], candidates.kind[ripe], candidates.grey[:, ripe],
            candidates.weight[:, ripe], idepths[good], candidates.host[ripe], inliers[:, good],
        )  # fmt: skip
        keep = candidates.outcome[: window.candidates.count] != trace_outcome.DELETED
        keep[chosen] = np.isinf(idepths)
        window.candidates.keep(keep)
        return int(ripe.size)

    def _adapt_spacing(self, active: int) -> None:
        """Less spacing when points are missing, more when there are too many, in steps that grow with the deviation."""
        surplus = active / self.wanted - 1.0
        self.spacing = float(np.clip(self.spacing + np.clip(2.0 * surplus, -0.8, 0.8), 0.0, MAX_SPACING))

    def _eligible(self, window: KeyframeWindow) -> np.ndarray:
        count = window.candidates.count
        candidates = window.candidates.arrays
        traced = np.isin(
            candidates.outcome[:count],
            (trace_outcome.GOOD, trace_outcome.SKIPPED, trace_outcome.BAD_CONDITION, trace_outcome.OUT_OF_BOUNDS),
        )
        narrow = (candidates.interval[:count] < self.config.max_interval) & np.isfinite(candidates.idepth_max[:count])
        quality = candidates.quality[:count]
        distinct = (quality > self.config.min_quality) & (quality < UNSEARCHED_QUALITY)
        older = candidates.host[:count] != window.newest
        return np.flatnonzero(traced & narrow & distinct & older)

    def _spread(self, window: KeyframeWindow, pairs: PairGeometry, eligible: np.ndarray) -> np.ndarray:
        """Which of the eligible candidates, (m,) bool, keep their distance from active points and from each other."""
        reach = int(np.ceil(self.spacing * LARGEST_KIND))
        self._distance2[:] = FAR
        points, count = window.points.arrays, window.points.count
        active = (points.u[:count], points.v[:count], points.idepth[:count], points.host[:count])
        x, y, _ = self._project(window, pairs, *active)
        stamp_all(self._distance2, x, y, reach)
        candidates = window.candidates.arrays
        middle = 0.5 * (candidates.idepth_min[eligible] + candidates.idepth_max[eligible])
        x, y, _ = self._project(
            window, pairs, candidates.u[eligible], candidates.v[eligible], middle, candidates.host[eligible]
        )
        accepted = np.zeros(eligible.size, np.bool_)
        spacing = (self.spacing * candidates.kind[eligible]).astype(np.float32)
        spread(x, y, spacing, self._distance2, reach, accepted)
        return accepted

    @staticmethod
    def _project(
        window: KeyframeWindow, pairs: PairGeometry, u: np.ndarray, v: np.ndarray, idepth: np.ndarray, host: np.ndarray
    ) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Half-resolution pixels and inverse depths of points in the newest keyframe."""
        x, y, new_idepth = (np.empty(u.size, np.float32) for _ in range(3))
        project_points(u, v, idepth, host, pairs, window.newest, x, y, new_idepth)
        return 0.5 * x - 0.25, 0.5 * y - 0.25, new_idepth
