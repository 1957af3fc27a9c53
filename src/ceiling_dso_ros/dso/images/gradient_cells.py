# SPDX-License-Identifier: BSD-3-Clause
"""Square cells of an image: their strongest pixels, and whether they have texture."""

import numpy as np

from ceiling_dso_ros.dso.images.selection import BORDER, SelectedPixels, squared_gradient

TEXTURE_LEVEL, TEXTURE_COLUMNS = 2, 26  # where texture is measured: pyramid level, and number of cells in its width
TEXTURE_GRADIENT2 = 3.0**2  # gradient of a cell's strongest pixel there; noise alone is well below


def strongest_per_cell(gradient2: np.ndarray, width: int, height: int, density: float) -> SelectedPixels:
    """The pixel with the largest gradient in every cell; the cell size gives about the wanted share of all pixels."""
    cell = max(1, round(1.0 / np.sqrt(density)))
    cells = _cells(gradient2, width, height, cell)
    rows, columns = cells.shape[:2]
    best = cells.argmax(axis=2)
    v = (np.arange(rows)[:, None] * cell + best // cell + BORDER).ravel()
    u = (np.arange(columns)[None, :] * cell + best % cell + BORDER).ravel()
    return SelectedPixels(u.astype(np.float32), v.astype(np.float32), np.ones(u.size, np.float32))


def textured_share(image: np.ndarray, width: int, height: int) -> float:
    """Share of an image of `TEXTURE_LEVEL` in which there is texture."""
    gradient2 = np.zeros(width * height, np.float32)
    squared_gradient(image, width, height, gradient2)
    strongest = _cells(gradient2, width, height, max(2, round(width / TEXTURE_COLUMNS))).max(axis=2)
    return float(np.mean(strongest > TEXTURE_GRADIENT2))


def _cells(gradient2: np.ndarray, width: int, height: int, cell: int) -> np.ndarray:
    """(rows, columns, cell * cell) pixels of a flat image by square cells; its border belongs to none."""
    image = gradient2.reshape(height, width)[BORDER : height - BORDER, BORDER : width - BORDER]
    rows, columns = image.shape[0] // cell, image.shape[1] // cell
    cells = image[: rows * cell, : columns * cell].reshape(rows, cell, columns, cell).swapaxes(1, 2)
    return cells.reshape(rows, columns, cell * cell)
