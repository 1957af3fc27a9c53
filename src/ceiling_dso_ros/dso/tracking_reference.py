"""The sparse depth of the newest keyframe on every pyramid level: what new frames are tracked against."""

from dataclasses import dataclass
from typing import Tuple

import numpy as np

from ceiling_dso_ros.dso.activation_kernels import project
from ceiling_dso_ros.dso.jit import kernel
from ceiling_dso_ros.dso.pair_geometry import pair_geometry
from ceiling_dso_ros.dso.points import INLIER
from ceiling_dso_ros.dso.pyramid import PyramidShape
from ceiling_dso_ros.dso.window import KeyframeWindow

BORDER = 2
DIAGONAL_LEVELS = 2  # levels below dilate to diagonal neighbours, those above to direct ones


@dataclass(frozen=True)
class ReferenceLevel:
    """Points of one level: pixel (u, v), inverse depth and grey value, each (n,) float32."""

    u: np.ndarray
    v: np.ndarray
    idepth: np.ndarray
    grey: np.ndarray


@dataclass(frozen=True)
class TrackingReference:
    """A keyframe to track against; does not change while the window goes on.

    Attributes:
        keyframe_id: the keyframe.
        T_camera_world: (4, 4) float64 its pose when the reference was made.
        affine: (2,) its brightness (a, b).
        exposure: ms, 1 when unknown.
        intrinsics: (4,) float64 of level 0.
        levels: finest first.
    """

    keyframe_id: int
    T_camera_world: np.ndarray
    affine: np.ndarray
    exposure: float
    intrinsics: np.ndarray
    levels: Tuple[ReferenceLevel, ...]


@kernel
def splat(
    x: np.ndarray, y: np.ndarray, idepth: np.ndarray, weight: np.ndarray, width: int, height: int,
    idepth_sum: np.ndarray, weight_sum: np.ndarray,
) -> None:  # fmt: skip
    """Add weighted inverse depths at their nearest pixels; flat maps."""
    for i in range(x.size):
        column, row = int(x[i] + np.float32(0.5)), int(y[i] + np.float32(0.5))
        if BORDER <= column < width - BORDER and BORDER <= row < height - BORDER:
            idepth_sum[row * width + column] += weight[i] * idepth[i]
            weight_sum[row * width + column] += weight[i]


@kernel
def sum_down(fine: np.ndarray, fine_width: int, width: int, height: int, coarse: np.ndarray) -> None:
    """Sum 2x2 pixels into one; flat maps."""
    for y in range(height):
        for x in range(width):
            p = 2 * y * fine_width + 2 * x
            coarse[y * width + x] = fine[p] + fine[p + 1] + fine[p + fine_width] + fine[p + fine_width + 1]


@kernel
def collect(
    idepth_sum: np.ndarray, weight_sum: np.ndarray, image: np.ndarray, width: int, height: int, diagonal: bool,
    u: np.ndarray, v: np.ndarray, idepth: np.ndarray, grey: np.ndarray,
) -> int:  # fmt: skip
    """List the pixels with depth, and the empty ones next to them with the mean of their neighbours'.

    Returns the number of points; the last four arrays are filled so far.
    """
    if diagonal:
        neighbours = np.array([-width - 1, -width + 1, width - 1, width + 1])
    else:
        neighbours = np.array([-1, 1, -width, width])
    count = 0
    for y in range(BORDER, height - BORDER):
        for x in range(BORDER, width - BORDER):
            p = y * width + x
            total, weight = idepth_sum[p], weight_sum[p]
            if weight == 0:
                for k in range(4):
                    total += idepth_sum[p + neighbours[k]]
                    weight += weight_sum[p + neighbours[k]]
            if weight > 0 and total > 0:
                u[count], v[count], idepth[count], grey[count] = x, y, total / weight, image[p]
                count += 1
    return count


class ReferenceBuilder:
    """Builds tracking references; holds the maps between keyframes."""

    def __init__(self, shape: PyramidShape) -> None:
        self._shape = shape
        self._idepth = [np.zeros(w * h, np.float32) for w, h in shape.sizes]
        self._weight = [np.zeros(w * h, np.float32) for w, h in shape.sizes]
        self._lists = np.zeros((4, shape.sizes[0][0] * shape.sizes[0][1]), np.float32)

    def build(self, window: KeyframeWindow) -> TrackingReference:
        """The newest keyframe with the depth of all points that are inliers in it."""
        newest = window.newest
        x, y, idepth, weight = self._visible_points(window)
        width, height = self._shape.sizes[0]
        self._idepth[0][:], self._weight[0][:] = 0, 0
        splat(x, y, idepth, weight, width, height, self._idepth[0], self._weight[0])
        for level in range(1, self._shape.levels):
            fine_width = self._shape.sizes[level - 1][0]
            for maps in (self._idepth, self._weight):
                sum_down(maps[level - 1], fine_width, *self._shape.sizes[level], maps[level])
        image_slot = int(window.keyframes.image_slot[newest])
        return TrackingReference(
            keyframe_id=window.ids[newest],
            T_camera_world=window.keyframes.T_camera_world[newest].copy(),
            affine=window.keyframes.affine[newest].copy(),
            exposure=float(window.keyframes.exposure[newest]),
            intrinsics=window.intrinsics,
            levels=tuple(
                self._level(level, window.pool.level(image_slot, level)) for level in range(self._shape.levels)
            ),
        )

    @staticmethod
    def _visible_points(window: KeyframeWindow) -> Tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        newest, count = window.newest, window.points.count
        points = window.points.arrays
        visible = np.flatnonzero(
            (window.points.residuals.live[newest, :count] > 0)
            & (window.points.residuals.state[newest, :count] == INLIER)
        )
        pairs = pair_geometry(window.keyframes, window.count, window.intrinsics)
        x, y, idepth = (np.empty(visible.size, np.float32) for _ in range(3))
        project(
            points.u[visible],
            points.v[visible],
            points.idepth[visible],
            points.host[visible],
            pairs,
            newest,
            x,
            y,
            idepth,
        )
        return x, y, idepth, np.sqrt(points.idepth_hessian[visible] + np.float32(1e-3))

    def _level(self, level: int, image: np.ndarray) -> ReferenceLevel:
        width, height = self._shape.sizes[level]
        count = collect(
            self._idepth[level], self._weight[level], image, width, height, level < DIAGONAL_LEVELS, *self._lists
        )
        return ReferenceLevel(*(row[:count].copy() for row in self._lists))
