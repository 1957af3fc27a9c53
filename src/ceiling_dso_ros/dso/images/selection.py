# SPDX-License-Identifier: BSD-3-Clause
"""Selects the candidate points of a keyframe: well spread pixels with large gradients for their surroundings.

The threshold adapts to the image: it is the median gradient of the 32x32 block plus a margin. In a grid of cells, the
strongest pixel of each cell is selected, measured along a pseudo-random direction of the cell. Cells two and four times
as large, with lower thresholds on coarser levels, fill regions where small cells found nothing. The cell size is
adapted until the wanted number of pixels is found.
"""

from dataclasses import dataclass
from typing import Tuple

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel, kernel_noalias
from ceiling_dso_ros.dso.images.pyramid import PyramidPool

BLOCK_BITS = 5
BLOCK = 1 << BLOCK_BITS
HISTOGRAM_CAP = 48
MEDIAN_MARGIN = 7.0
LEVEL_FACTOR = np.array([1.0, 0.75, 0.42], np.float32)  # on the squared threshold, per level
BORDER = 4
MAX_CELL = 24

_angles = np.arange(16) * (2.0 * np.pi / 16)
DIRECTIONS = np.stack([np.cos(_angles), np.sin(_angles)]).astype(np.float32)


@dataclass(frozen=True)
class SelectedPixels:
    """Chosen pixels in row order.

    Attributes:
        u, v: (n,) float32 coordinates on level 0.
        kind: (n,) float32: 1, 2 or 4, the size of the cell that a pixel stands for.
    """

    u: np.ndarray
    v: np.ndarray
    kind: np.ndarray


@kernel_noalias
def squared_gradient(image: np.ndarray, width: int, height: int, result: np.ndarray) -> None:
    """|grad I|^2 by central differences into result; flat arrays, zero in the outermost pixels."""
    result[:] = np.float32(0)
    for y in range(1, height - 1):
        above = image[(y - 1) * width : y * width]
        row = image[y * width : (y + 1) * width]
        below = image[(y + 1) * width : (y + 2) * width]
        out = result[y * width : (y + 1) * width]
        for x in range(1, width - 1):
            dx = row[x + 1] - row[x - 1]
            dy = below[x] - above[x]
            out[x] = np.float32(0.25) * (dx * dx + dy * dy)


@kernel
def block_thresholds(gradient2: np.ndarray, width: int, height: int) -> np.ndarray:
    """Squared gradient thresholds per 32x32 block, (rows, columns) float32, smoothed over 3x3 blocks."""
    rows, columns = (height + BLOCK - 1) // BLOCK, (width + BLOCK - 1) // BLOCK
    medians = np.empty((rows, columns), np.float32)
    histogram = np.empty(HISTOGRAM_CAP + 1, np.int64)
    for row in range(rows):
        for column in range(columns):
            histogram[:] = 0
            for y in range(max(1, row * BLOCK), min(height - 1, (row + 1) * BLOCK)):
                for x in range(max(1, column * BLOCK), min(width - 1, (column + 1) * BLOCK)):
                    histogram[min(int(np.sqrt(gradient2[y * width + x])), HISTOGRAM_CAP)] += 1
            remaining = histogram.sum() // 2
            median = 0
            while median < HISTOGRAM_CAP and remaining >= histogram[median]:
                remaining -= histogram[median]
                median += 1
            medians[row, column] = median + MEDIAN_MARGIN
    thresholds = np.empty((rows, columns), np.float32)
    for row in range(rows):
        for column in range(columns):
            neighbours = medians[max(0, row - 1) : row + 2, max(0, column - 1) : column + 2]
            mean = neighbours.sum() / np.float32(neighbours.size)
            thresholds[row, column] = mean * mean
    return thresholds


@kernel
def strongest_in_cell(
    images: Tuple, gradients2: Tuple, widths: Tuple, thresholds: np.ndarray, level: int,
    x0: int, y0: int, x1: int, y1: int, direction: int,
) -> int:  # fmt: skip
    """Index (y * width + x on level 0) of the strongest pixel of [x0, x1) x [y0, y1) on a level, -1 if none passes.

    Each pixel of the level is considered once, and represents its first pixel on level 0 in the cell.
    """
    if x0 >= x1 or y0 >= y1:
        return -1
    coarse_width = widths[level]
    image, gradient2 = images[level], gradients2[level]
    dir_x, dir_y = DIRECTIONS[0, direction], DIRECTIONS[1, direction]
    factor, to_block = LEVEL_FACTOR[level], BLOCK_BITS - level
    best, best_x, best_y = np.float32(0), -1, -1
    for y in range(y0 >> level, ((y1 - 1) >> level) + 1):
        block_thresholds = thresholds[y >> to_block]
        for x in range(x0 >> level, ((x1 - 1) >> level) + 1):
            p = y * coarse_width + x
            if gradient2[p] <= block_thresholds[x >> to_block] * factor:
                continue
            grad_x = image[p + 1] - image[p - 1]
            grad_y = image[p + coarse_width] - image[p - coarse_width]
            strength = abs(grad_x * dir_x + grad_y * dir_y)
            if strength > best:
                best, best_x, best_y = strength, x, y
    if best_x < 0:
        return -1
    return max(best_y << level, y0) * widths[0] + max(best_x << level, x0)


@kernel
def cell_direction(x: int, y: int, level: int) -> int:
    """A fixed pseudo-random direction 0..15 for a cell: the same image always gives the same points."""
    mixed = np.uint32(x) * np.uint32(73856093) ^ np.uint32(y) * np.uint32(19349663)
    mixed ^= np.uint32(level) * np.uint32(83492791)
    mixed = (mixed ^ (mixed >> np.uint32(13))) * np.uint32(0x5BD1E995)
    return np.int64((mixed >> np.uint32(15)) & np.uint32(15))  # type: ignore[return-value]  # to numba an int


@kernel
def select_in_grid(
    images: Tuple, gradients2: Tuple, widths: Tuple, height: int, thresholds: np.ndarray, cell: int,
    indices: np.ndarray, kinds: np.ndarray,
) -> int:  # fmt: skip
    """Pick pixels with cells of cell, 2 cell and 4 cell pixels; fills indices and kinds, returns their number."""
    width = widths[0]
    right, bottom = width - BORDER - 1, height - BORDER - 1
    count = 0
    for y4 in range(BORDER, bottom, 4 * cell):
        for x4 in range(BORDER, right, 4 * cell):
            found_in_4 = False
            for quadrant in range(4):
                x2, y2 = x4 + (quadrant & 1) * 2 * cell, y4 + (quadrant >> 1) * 2 * cell
                found_in_2 = False
                for quarter in range(4):
                    x1, y1 = x2 + (quarter & 1) * cell, y2 + (quarter >> 1) * cell
                    pick = strongest_in_cell(
                        images, gradients2, widths, thresholds, 0,
                        x1, y1, min(x1 + cell, right), min(y1 + cell, bottom), cell_direction(x1, y1, 0),
                    )  # fmt: skip
                    if pick >= 0 and count < indices.size:
                        indices[count], kinds[count] = pick, 1
                        count += 1
                        found_in_2 = True
                if not found_in_2:
                    pick = strongest_in_cell(
                        images, gradients2, widths, thresholds, 1,
                        x2, y2, min(x2 + 2 * cell, right), min(y2 + 2 * cell, bottom), cell_direction(x2, y2, 1),
                    )  # fmt: skip
                    if pick >= 0 and count < indices.size:
                        indices[count], kinds[count] = pick, 2
                        count += 1
                        found_in_2 = True
                found_in_4 = found_in_4 or found_in_2
            if not found_in_4:
                pick = strongest_in_cell(
                    images, gradients2, widths, thresholds, 2,
                    x4, y4, min(x4 + 4 * cell, right), min(y4 + 4 * cell, bottom), cell_direction(x4, y4, 2),
                )  # fmt: skip
                if pick >= 0 and count < indices.size:
                    indices[count], kinds[count] = pick, 4
                    count += 1
    return count


class PixelSelector:
    """Selects about a wanted number of pixels; starts with the cell size of the last image."""

    def __init__(self, pool: PyramidPool) -> None:
        self._pool = pool
        self._levels = min(3, pool.shape.levels)
        self._gradients2 = tuple(np.zeros(w * h, np.float32) for w, h in pool.shape.sizes[: self._levels])
        width, height = pool.shape.sizes[0]
        self._indices = np.zeros(width * height // 4, np.int64)
        self._kinds = np.zeros(width * height // 4, np.float32)
        self.cell = 3

    def select(self, slot: int, wanted: int) -> SelectedPixels:
        """About `wanted` pixels of the pyramid in slot, fewer where the image has too little texture."""
        images, widths, thresholds = self._prepare(slot)
        height = self._pool.shape.sizes[0][1]
        arguments = (images, self._gradients2, widths, height, thresholds)
        count = select_in_grid(*arguments, self.cell, self._indices, self._kinds)
        for _ in range(4):
            better = self._better_cell(wanted, count)
            if better == self.cell:
                break
            self.cell = better
            count = select_in_grid(*arguments, self.cell, self._indices, self._kinds)
        return self._thinned(count, wanted, widths[0])

    def gradient2_at(self, slot: int, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Squared gradient, (n,) float32, of the image in slot at the pixels nearest to (u, v)."""
        width, height = self._pool.shape.sizes[0]
        gradient2 = np.zeros(width * height, np.float32)
        squared_gradient(self._pool.level(slot, 0), width, height, gradient2)
        return gradient2[np.rint(v).astype(int) * width + np.rint(u).astype(int)]

    def _prepare(self, slot: int) -> Tuple[Tuple[np.ndarray, ...], Tuple[int, ...], np.ndarray]:
        images = tuple(self._pool.level(slot, level) for level in range(self._levels))
        for level, (width, height) in enumerate(self._pool.shape.sizes[: self._levels]):
            squared_gradient(images[level], width, height, self._gradients2[level])
        widths = tuple(width for width, _ in self._pool.shape.sizes[: self._levels])
        return images, widths, block_thresholds(self._gradients2[0], *self._pool.shape.sizes[0])

    def _better_cell(self, wanted: int, found: int) -> int:
        """The cell size for which about `wanted` would be found, as found is proportional to 1 / (cell + 1)^2."""
        if 1.0 <= found / wanted <= 1.25:
            return self.cell
        cell = int((self.cell + 1) * np.sqrt(max(found, 1) / wanted)) - 1
        return int(np.clip(cell, 1, MAX_CELL))

    def _thinned(self, count: int, wanted: int, width: int) -> SelectedPixels:
        indices, kinds = self._indices[:count], self._kinds[:count]
        if count > wanted:  # drop pixels evenly, by a fixed random order
            keep = np.random.default_rng(count).permutation(count)[:wanted]
            indices, kinds = indices[keep], kinds[keep]
        order = np.argsort(indices, kind="stable")
        indices = indices[order]
        return SelectedPixels(
            (indices % width).astype(np.float32), (indices // width).astype(np.float32), kinds[order].copy()
        )
