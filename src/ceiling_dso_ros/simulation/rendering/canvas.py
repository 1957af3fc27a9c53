# SPDX-License-Identifier: BSD-3-Clause
"""A canvas for the texture of a material: positions in metres, the same texture at every resolution.

A texel is a sample, not an area: texel (j, i) holds the value at (u, v) = (i, j) * texel_m. At the end the texture is
low-pass filtered, so that bilinear interpolation between texels shows no steps.
"""

from typing import Sequence, Tuple

import cv2
import numpy as np
from scipy.sparse import csr_matrix


class Canvas:
    """A rectangle of surface values (reflectance 0..1, or radiance of what shines) that grows layer by layer.

    Attributes:
        values: (rows, columns) float32.
        size_m: (width, height) in metres.
        texel_m: spacing of the samples in metres.
        rng: for positions and similar choices; noise has its own generators, so it does not depend on the resolution.
    """

    def __init__(self, size_m: Tuple[float, float], texel_m: float, seed: Sequence[int], base: float) -> None:
        columns, rows = (int(np.ceil(side / texel_m)) + 2 for side in size_m)
        self.values = np.full((rows, columns), base, dtype=np.float32)
        self.size_m = size_m
        self.texel_m = texel_m
        self._seeds = np.random.SeedSequence(seed)
        self.rng = np.random.default_rng(self._seeds)

    def noise(self, wavelength_m: Tuple[float, float], amplitude: float) -> None:
        """Multiply by 1 + amplitude x smooth noise of unit variance, with wavelengths of wavelength_m along u and v."""
        rng = np.random.default_rng(self._seeds.spawn(1)[0])
        if min(wavelength_m) < 3.0 * self.texel_m:
            return  # would be filtered away
        weights = []
        for wave, side, texels in zip(wavelength_m[::-1], self.size_m[::-1], self.values.shape):
            varies = wave < 1.5 * side
            nodes = int(side / wave) + 2 if varies else 1
            weights.append(_cubic_weights(nodes, wave / self.texel_m, texels if varies else 1))
        along, across = weights
        lattice = rng.standard_normal((along.shape[1], across.shape[1]), dtype=np.float32)
        smooth = along @ np.ascontiguousarray((across @ lattice.T).T)
        self.values *= np.maximum(1.0 + np.float32(1.3 * amplitude) * smooth, 0.2)

    def stripes(self, axis: int, positions_m: np.ndarray, width_m: float, gain: float) -> None:
        """Multiply by gain on straight bands across the whole canvas, at positions_m along u (axis 0) or v (axis 1)."""
        profile = np.zeros(self.values.shape[1 - axis], dtype=np.float32)
        for position in np.atleast_1d(positions_m):
            profile += self._coverage(position - width_m / 2, position + width_m / 2, len(profile))
        factor = 1.0 + np.float32(gain - 1.0) * np.minimum(profile, 1.0)
        self.values *= factor[None, :] if axis == 0 else factor[:, None]

    def rectangle(self, corner_m: Tuple[float, float], size_m: Tuple[float, float], gain: float) -> None:
        """Multiply by gain inside an upright rectangle."""
        rows, columns = self.values.shape
        across = self._coverage(corner_m[0], corner_m[0] + size_m[0], columns)
        along = self._coverage(corner_m[1], corner_m[1] + size_m[1], rows)
        i, j = np.flatnonzero(across), np.flatnonzero(along)
        if len(i) and len(j):
            part = self.values[j[0] : j[-1] + 1, i[0] : i[-1] + 1]
            part *= 1.0 + np.float32(gain - 1.0) * np.outer(along[j], across[i])

    def spots(self, centers_m: np.ndarray, radius_m: float, gain: float) -> None:
        """Multiply by gain in soft round spots, (n, 2) centres: screws, stains, holes."""
        reach = max(2.5 * radius_m, 1.5 * self.texel_m)
        for u, v in np.reshape(centers_m, (-1, 2)):
            columns = self._range(u, reach, self.values.shape[1])
            rows = self._range(v, reach, self.values.shape[0])
            distance2 = (np.arange(rows.start, rows.stop)[:, None] * self.texel_m - v) ** 2
            distance2 = distance2 + (np.arange(columns.start, columns.stop)[None, :] * self.texel_m - u) ** 2
            spot = np.exp(-0.5 * distance2 / radius_m**2).astype(np.float32)
            self.values[rows, columns] *= 1.0 + np.float32(gain - 1.0) * spot

    def curve(self, points_m: np.ndarray, width_m: float, gain: float) -> None:
        """Multiply by gain along an open polyline, (n, 2) points: cracks, edges of stains."""
        points = np.asarray(points_m)
        columns, rows = (
            slice(
                self._range(points[:, i].min(), width_m, self.values.shape[1 - i]).start,
                self._range(points[:, i].max(), width_m, self.values.shape[1 - i]).stop,
            )
            for i in (0, 1)
        )
        part = self.values[rows, columns]
        mask = np.zeros(part.shape, dtype=np.uint8)
        line = np.round((points / self.texel_m - (columns.start, rows.start)) * 16).astype(np.int32)
        thickness = max(1, round(width_m / self.texel_m))
        if mask.size:
            cv2.polylines(mask, [line], False, (255,), thickness, cv2.LINE_AA, shift=4)
        part *= _mixed(gain, mask, min(1.0, width_m / self.texel_m))

    def text(self, text: str, gain: float) -> None:
        """Multiply by gain inside the letters of a line of text that fills the canvas."""
        face, unit = cv2.FONT_HERSHEY_DUPLEX, 2.0
        (width, height), baseline = cv2.getTextSize(text, face, unit, 6)
        picture = np.zeros((height + 2 * baseline, width + 2 * baseline), dtype=np.uint8)
        cv2.putText(picture, text, (baseline, height + baseline), face, unit, (255,), 6, cv2.LINE_AA)
        rows, columns = self.values.shape
        self.values *= _mixed(gain, cv2.resize(picture, (columns, rows), interpolation=cv2.INTER_AREA)[::-1])

    def low_pass(self, sigma_m: float) -> None:
        """Gaussian low-pass, so that no detail is finer than what the camera resolves."""
        self.values = cv2.GaussianBlur(self.values, (0, 0), sigma_m / self.texel_m, borderType=cv2.BORDER_REPLICATE)

    def _coverage(self, start_m: float, end_m: float, count: int) -> np.ndarray:
        """How much of the texel-wide interval around each sample lies within [start_m, end_m]."""
        low = np.arange(count) - 0.5
        return np.clip(
            np.minimum(end_m / self.texel_m, low + 1) - np.maximum(start_m / self.texel_m, low), 0, 1
        ).astype(np.float32)

    def _range(self, center_m: float, reach_m: float, count: int) -> slice:
        low, high = ((center_m + side * reach_m) / self.texel_m for side in (-1, 1))
        return slice(min(max(int(low), 0), count), min(max(int(high) + 2, 0), count))


def _cubic_weights(nodes: int, texels_per_node: float, texels: int) -> csr_matrix:
    """Weights of nodes in the texels between them, (texels, nodes) float32; beyond the edges the last node goes on.

    Cubic convolution (Keys 1981) with a = -0.75. cv2.resize is not used, because its rounding depends on the number of
    threads.
    """
    position = (np.arange(texels) + 0.5) / texels_per_node - 0.5
    nearby = np.floor(position)[:, None] + np.arange(-1, 3)
    d = np.abs(position[:, None] - nearby)
    weights = np.where(d < 1.0, (1.25 * d - 2.25) * d**2 + 1.0, ((-0.75 * d + 3.75) * d - 6.0) * d + 3.0)
    indices = np.clip(nearby, 0, nodes - 1).astype(np.int32)
    starts = 4 * np.arange(texels + 1)
    return csr_matrix((weights.astype(np.float32).ravel(), indices.ravel(), starts), shape=(texels, nodes))


def _mixed(gain: float, mask: np.ndarray, opacity: float = 1.0) -> np.ndarray:
    """Factor that is gain where the mask (uint8) is 255 and 1 where it is 0."""
    return 1.0 + np.float32((gain - 1.0) * opacity / 255.0) * mask
