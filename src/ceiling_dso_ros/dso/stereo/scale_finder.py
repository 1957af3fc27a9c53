# SPDX-License-Identifier: BSD-3-Clause
"""Measures the scale of the map at a keyframe by the image of a second camera."""

import math
from typing import NamedTuple, Optional, Tuple

import numpy as np

from ceiling_dso_ros.dso.config import RigConfig
from ceiling_dso_ros.dso.images.noise import smooth_image
from ceiling_dso_ros.dso.status import NO_SCALE, ScaleMeasurement
from ceiling_dso_ros.dso.stereo.matching_kernels import BORDER, correlations, match
from ceiling_dso_ros.dso.stereo.rig import StereoRig
from ceiling_dso_ros.dso.stereo.scale import (
    LEAST_POINTS,
    PointScales,
    cells,
    estimate_scale,
)

SEARCHED = 200  # points with which the scale is looked for
LEAST_DISPARITY, LARGEST_DISPARITY = 1.0, 64.0  # pixels of the middle point, in the search
STEP = 0.5  # pixels
APART = 4.0  # pixels: what is further from the best place is another one; finer patterns are too fine to be told apart
CERTAIN = 5.0  # standard deviations by which the best place must be better than any other, by at least this:
MARGIN = 0.1  # of the correlation of two patches
STARTS, CLOSE = 4, 0.3  # of the search for the places; pixels by which its start may be wrong
LEAST_FOUND = 0.25  # share of the points that a right scale finds; by chance, a wrong one finds one in ten
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
            known: metres per unit by the keyframe before. Points are looked for next to where it places them, and all
                over their lines only if too few are found there.
        """
        if smooth:
            raw, right = right, np.empty_like(right)
            smooth_image(raw, np.empty_like(raw), right)
        images = _Images(left, right, self._rig.warp(left_matrix))
        height, width = left.shape
        inside = (points.u > BORDER) & (points.u < width - 1 - BORDER) & (points.v > BORDER)
        chosen = np.flatnonzero(inside & (points.v < height - 1 - BORDER) & (points.idepth > 0.0))
        points = SeenPoints(*(np.ascontiguousarray(array[chosen]) for array in points))
        if chosen.size < LEAST_POINTS:
            return NO_SCALE
        scales = None if known is None else self._measured(images, points, known)
        if scales is None or len(scales.mapped) < LEAST_FOUND * chosen.size:
            about = _search(images, points)
            if about is None:
                return NO_SCALE
            scales = self._measured(images, points, about)
        result = self._estimate(scales)
        if math.isfinite(result.log_scale):
            # those that are not seen any more are not seen again
            self._used = np.union1d(self._used[np.isin(self._used, points.name)], scales.name)
        return result

    def _estimate(self, scales: PointScales) -> ScaleMeasurement:
        return estimate_scale(scales, self._config.baseline_sigma, self._config.disparity_sigma)

    def _measured(self, images: "_Images", points: SeenPoints, about: float) -> PointScales:
        """The points that are found, from a scale on that is about right: near their places nothing is cut off."""
        for _ in range(STARTS):
            scales = self._found(images, points, about)
            before, log_scale = about, self._estimate(scales).log_scale
            if not math.isfinite(log_scale):
                break
            about = math.exp(log_scale)
            if float(np.median(scales.reach * scales.measured)) * abs(about / before - 1.0) < CLOSE:
                break
        return scales

    def _found(self, images: "_Images", points: SeenPoints, metres_per_unit: float) -> PointScales:
        """The points that are found about where a scale places them."""
        found, reach, sigma = (np.zeros(len(points.u)) for _ in range(3))
        inverse_depths = points.idepth.astype(np.float64) / metres_per_unit
        (height, width), (right_height, right_width) = images.left.shape, images.right.shape
        match(
            images.left.ravel(), width, height, images.right.ravel(), right_width, right_height, *images.warp,
            points.u, points.v, inverse_depths, found, reach, sigma,
        )  # fmt: skip
        good = np.isfinite(found) & (found > 0.0) & (sigma > 0.0)
        names = points.name[good]
        return PointScales(
            points.idepth[good].astype(np.float64), found[good], reach[good], sigma[good],
            cells(points.u[good], points.v[good], width, height), ~np.isin(names, self._used), names,
        )  # fmt: skip


class _Images(NamedTuple):
    """Images of one moment, (height, width) float32 each, and M, t of the warp from the left to the right one."""

    left: np.ndarray
    right: np.ndarray
    warp: Tuple[np.ndarray, np.ndarray]


def _search(images: _Images, points: SeenPoints) -> Optional[float]:
    """Metres per unit to about half a pixel; None where no scale is clearly better than all others.

    A point fits a scale as well as it fits anywhere within a pixel around: depths in the map are not exact, which
    counts the more the larger the disparity is. Whether two scales differ is judged by the differences of all points,
    in standard deviations of their mean.
    """
    some = np.linspace(0, len(points.u) - 1, min(SEARCHED, len(points.u))).astype(np.int64)
    u, v, idepth, _ = (np.ascontiguousarray(array[some]) for array in points)
    disparities = np.arange(LEAST_DISPARITY, LARGEST_DISPARITY, STEP)
    reach = math.hypot(*images.warp[1][:2])  # pixels per 1/m, of a camera beside the other
    scales = reach * float(np.median(idepth)) / disparities
    fits = correlations(
        images.left.ravel(), images.left.shape[1], images.right.ravel(), images.right.shape[1], images.right.shape[0],
        *images.warp, u, v, idepth, scales,
    )  # fmt: skip
    fits = _best_around(fits, round(1.0 / STEP))
    seen = np.isfinite(fits)
    counts = seen.sum(axis=1)
    means = np.where(seen, fits, 0.0).sum(axis=1) / np.maximum(counts, 1)
    means[counts < max(LEAST_SEEN * len(u), LEAST_POINTS)] = -1.0
    best = int(np.argmax(means))
    if means[best] <= 0.0:
        return None
    for other in np.flatnonzero((np.abs(disparities - disparities[best]) > APART) & (means > -1.0)):
        both = seen[best] & seen[other]
        better = fits[best, both] - fits[other, both]
        if better.size and better.mean() < MARGIN + CERTAIN * better.std() / math.sqrt(better.size):
            return None
    return float(scales[best])


def _best_around(fits: np.ndarray, reach: int) -> np.ndarray:
    """Largest of `fits`, (m, n), within some rows of each; nan where all are."""
    padded = np.pad(fits, ((reach, reach), (0, 0)), constant_values=np.nan)
    return np.fmax.reduce([padded[shift : shift + len(fits)] for shift in range(2 * reach + 1)])
