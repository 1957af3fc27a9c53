# SPDX-License-Identifier: BSD-3-Clause
"""Measures the scale of the map at a keyframe by the image of a second camera."""

import math
from typing import NamedTuple, Optional, Tuple

import numpy as np

from ceiling_dso_ros.dso.config import RigConfig
from ceiling_dso_ros.dso.images.noise import smooth_image
from ceiling_dso_ros.dso.stereo.matching_kernels import BORDER, correlations, match
from ceiling_dso_ros.dso.stereo.rig import StereoRig
from ceiling_dso_ros.dso.stereo.scale import (
    LEAST_POINTS,
    NO_SCALE,
    PointScales,
    ScaleMeasurement,
    cells,
    estimate_scale,
)

SEARCHED = 200  # points with which the scale is looked for
LEAST_DISPARITY, LARGEST_DISPARITY = 1.0, 64.0  # pixels of the middle point, in the search
STEP = 0.5  # pixels
APART = 4.0  # pixels: what is further from the best place is another one; finer patterns are too fine to be told apart
CERTAIN = 5.0  # standard deviations by which the best place must be better than any other, by at least this:
MARGIN = 0.1  # of the correlation of two patches
LEAST_SEEN = 0.5  # share of the points that an assumed scale must place in the right image


class SeenPoints(NamedTuple):
    """Points of the map in a keyframe that is not their host.

    Attributes:
        u, v: (n,) float32 pixels.
        idepth: (n,) float32 inverse depth, 1/unit, positive.
        name: (n,) int64 identity of each point, the same in all keyframes.
    """

    u: np.ndarray
    v: np.ndarray
    idepth: np.ndarray
    name: np.ndarray


class ScaleFinder:
    """Measures the scale keyframe by keyframe, for one segment."""

    def __init__(self, rig: StereoRig, config: RigConfig) -> None:
        self._rig = rig
        self._config = config
        self._used = np.zeros(0, np.int64)  # names of points that have told what they know

    def measure(
        self, left: np.ndarray, left_matrix: np.ndarray, right: np.ndarray, smooth: bool, points: SeenPoints,
        known: Optional[float] = None,
    ) -> ScaleMeasurement:  # fmt: skip
        """Metres per unit; NO_SCALE where the images do not tell it.

        Args:
            left: (height, width) float32 image of the keyframe.
            left_matrix: its K, (3, 3) float64.
            right: (height, width) float32 image of the second camera.
            smooth: the left image was smoothed against its noise, and so is the right one to be.
            points: those of the map that the keyframe sees.
            known: metres per unit by the keyframe before; where a roof repeats itself, the place next to it is taken.
        """
        if smooth:
            raw, right = right, np.empty_like(right)
            smooth_image(raw, np.empty_like(raw), right)
        warp = self._rig.warp(left_matrix)
        height, width = left.shape
        inside = (points.u > BORDER) & (points.u < width - 1 - BORDER) & (points.v > BORDER)
        chosen = np.flatnonzero(inside & (points.v < height - 1 - BORDER) & (points.idepth > 0.0))
        points = SeenPoints(*(np.ascontiguousarray(array[chosen]) for array in points))
        if chosen.size < LEAST_POINTS:
            return NO_SCALE
        about = self._search(left, warp, right, points) or known
        if about is None:
            return NO_SCALE
        found, reach, sigma = (np.zeros(chosen.size) for _ in range(3))
        match(
            left.ravel(), width, height, right.ravel(), self._rig.right.width, self._rig.right.height, *warp,
            points.u, points.v, points.idepth.astype(np.float64) / about, found, reach, sigma,
        )  # fmt: skip
        good = np.isfinite(found) & (found > 0.0) & (sigma > 0.0)
        names = points.name[good]
        scales = PointScales(
            points.idepth[good].astype(np.float64), found[good], reach[good], sigma[good],
            cells(points.u[good], points.v[good], width, height), ~np.isin(names, self._used),
        )  # fmt: skip
        result = estimate_scale(scales, self._config.baseline_sigma, self._config.disparity_sigma)
        if math.isfinite(result.log_scale):
            # those that are not seen any more are not seen again
            self._used = np.union1d(self._used[np.isin(self._used, points.name)], names)
        return result

    def _search(
        self, left: np.ndarray, warp: Tuple[np.ndarray, np.ndarray], right: np.ndarray, points: SeenPoints
    ) -> Optional[float]:
        """Metres per unit to about half a pixel; None where no scale is clearly better than all others.

        A point fits a scale as well as it fits anywhere within a pixel around: depths in the map are not exact, which
        counts the more the larger the disparity is. Whether two scales differ is judged by the differences of all
        points, in standard deviations of their mean.
        """
        some = np.linspace(0, len(points.u) - 1, min(SEARCHED, len(points.u))).astype(np.int64)
        u, v, idepth, _ = (np.ascontiguousarray(array[some]) for array in points)
        disparities = np.arange(LEAST_DISPARITY, LARGEST_DISPARITY, STEP)
        reach = math.hypot(warp[1][0], warp[1][1])  # pixels per 1/m, of a camera beside the other
        scales = reach * float(np.median(idepth)) / disparities
        fits = correlations(
            left.ravel(), left.shape[1], right.ravel(), self._rig.right.width, self._rig.right.height, *warp,
            u, v, idepth, scales,
        )  # fmt: skip
        fits = _best_around(fits, round(1.0 / STEP))
        seen = np.isfinite(fits)
        counts = seen.sum(axis=1)
        means = np.where(seen, fits, 0.0).sum(axis=1) / np.maximum(counts, 1)
        means[counts < max(LEAST_SEEN * len(u), LEAST_POINTS)] = -1.0
        best = int(np.argmax(means))
        if means[best] <= 0.0:
            return None
        others = np.flatnonzero((np.abs(disparities - disparities[best]) > APART) & (means > -1.0))
        for other in others:
            both = seen[best] & seen[other]
            better = fits[best, both] - fits[other, both]
            if better.size and better.mean() < MARGIN + CERTAIN * better.std() / math.sqrt(better.size):
                return None
        return float(scales[best])


def _best_around(fits: np.ndarray, reach: int) -> np.ndarray:
    """Largest of `fits`, (m, n), within some rows of each; nan where all are."""
    padded = np.pad(fits, ((reach, reach), (0, 0)), constant_values=np.nan)
    return np.fmax.reduce([padded[shift : shift + len(fits)] for shift in range(2 * reach + 1)])
