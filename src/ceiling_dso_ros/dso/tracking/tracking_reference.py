# SPDX-License-Identifier: BSD-3-Clause
"""The sparse depth of the newest keyframe on every pyramid level: what new frames are tracked against."""

from dataclasses import dataclass
from typing import Tuple

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel
from ceiling_dso_ros.dso.images.pyramid import PyramidShape
from ceiling_dso_ros.dso.window.keyframe_window import KeyframeWindow
from ceiling_dso_ros.dso.window.visible_points import visible_points

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
        exposure: on the scale of `ExposureScale`.
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
    idepth_sum: np.ndarray, weight_sum: np.ndarray, pixels: np.ndarray,
) -> int:  # fmt: skip
    """Add weighted inverse depths at their nearest pixels; flat maps. Lists the pixels hit; returns their number."""
    count = 0
    for i in range(x.size):
        column, row = int(x[i] + np.float32(0.5)), int(y[i] + np.float32(0.5))
        if BORDER <= column < width - BORDER and BORDER <= row < height - BORDER:
            p = row * width + column
            if weight_sum[p] == 0:
                pixels[count] = p
                count += 1
            idepth_sum[p] += weight[i] * idepth[i]
            weight_sum[p] += weight[i]
    return count


@kernel
def sum_down(
    pixels: np.ndarray, fine_idepth: np.ndarray, fine_weight: np.ndarray, fine_width: int, width: int, height: int,
    idepth_sum: np.ndarray, weight_sum: np.ndarray, coarse_pixels: np.ndarray,
) -> int:  # fmt: skip
    """Sum the listed pixels of a map into those of the next coarser level; lists them, and returns their number."""
    count = 0
    for fine in pixels:
        row, column = fine // fine_width // 2, fine % fine_width // 2
        if row < height and column < width:
            p = row * width + column
            if weight_sum[p] == 0:
                coarse_pixels[count] = p
                count += 1
            idepth_sum[p] += fine_idepth[fine]
            weight_sum[p] += fine_weight[fine]
    return count


@kernel
def collect(
    pixels: np.ndarray, idepth_sum: np.ndarray, weight_sum: np.ndarray, image: np.ndarray, width: int, height: int,
    diagonal: bool, seen: np.ndarray, u: np.ndarray, v: np.ndarray, idepth: np.ndarray, grey: np.ndarray,
) -> int:  # fmt: skip
    """List the pixels with depth, and the empty pixels next to them with the mean depth of their neighbours.

    Args:
        pixels: those with depth.
        seen: flat uint8 map, zero before and after.
        u, v, idepth, grey: outputs.

    Returns:
        The number of points.
    """
    if diagonal:
        neighbours = np.array([0, -width - 1, -width + 1, width - 1, width + 1])
    else:
        neighbours = np.array([0, -1, 1, -width, width])
    count = 0
    for k in range(neighbours.size):
        for centre in pixels:
            p = centre + neighbours[k]
            row, column = p // width, p % width
            if seen[p] or not (BORDER <= column < width - BORDER and BORDER <= row < height - BORDER):
                continue
            seen[p] = 1
            total, weight = idepth_sum[p], weight_sum[p]
            if k > 0:
                total = weight = np.float32(0)
                for other in range(1, 5):
                    total += idepth_sum[p + neighbours[other]]
                    weight += weight_sum[p + neighbours[other]]
            if total > 0:
                u[count], v[count], idepth[count], grey[count] = column, row, total / weight, image[p]
                count += 1
    for k in range(neighbours.size):
        for centre in pixels:
            seen[centre + neighbours[k]] = 0
    return count


class ReferenceBuilder:
    """Builds tracking references; holds the maps between keyframes."""

    def __init__(self, shape: PyramidShape) -> None:
        self._shape = shape
        self._idepth = [np.zeros(w * h, np.float32) for w, h in shape.sizes]
        self._weight = [np.zeros(w * h, np.float32) for w, h in shape.sizes]
        size = shape.sizes[0][0] * shape.sizes[0][1]
        self._seen = np.zeros(size, np.uint8)
        self._lists = np.zeros((4, size), np.float32)
        self._pixel_list = np.zeros(size, np.int64)
        self._pixels = [np.zeros(0, np.int64)] * shape.levels  # those with depth, of each level

    def build(self, window: KeyframeWindow) -> TrackingReference:
        """The newest keyframe with the depth of all points that are inliers in it."""
        newest = window.newest
        for pixels, idepth_sum, weight_sum in zip(self._pixels, self._idepth, self._weight):
            idepth_sum[pixels], weight_sum[pixels] = 0, 0
        width, height = self._shape.sizes[0]
        seen = visible_points(window)
        weight = np.sqrt(window.points.arrays.idepth_hessian[seen.number] + np.float32(1e-3))
        count = splat(*seen[1:], weight, width, height, self._idepth[0], self._weight[0], self._pixel_list)
        self._pixels[0] = np.sort(self._pixel_list[:count])  # sampling is faster in memory order
        for level in range(1, self._shape.levels):
            fine = level - 1
            count = sum_down(
                self._pixels[fine], self._idepth[fine], self._weight[fine], self._shape.sizes[fine][0],
                *self._shape.sizes[level], self._idepth[level], self._weight[level], self._pixel_list,
            )  # fmt: skip
            self._pixels[level] = np.sort(self._pixel_list[:count])
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

    def _level(self, level: int, image: np.ndarray) -> ReferenceLevel:
        width, height = self._shape.sizes[level]
        count = collect(
            self._pixels[level], self._idepth[level], self._weight[level], image, width, height,
            level < DIAGONAL_LEVELS, self._seen, *self._lists,
        )  # fmt: skip
        return ReferenceLevel(*(row[:count].copy() for row in self._lists))
