# SPDX-License-Identifier: BSD-3-Clause
"""How many metres a unit of the map is, from the map's points in the images of two cameras.

Point i has the inverse depth d_i in the map (1/unit), and is found at p_i pixels per 1/m along its epipolar line where
its inverse depth is m_i (1/m). With k units per metre, m_i = k d_i. The estimate is the root of

    sum w_i psi(p_i (m_i - k d_i) / s_i) / s_i = 0,    s_i^2 = s_image,i^2 + s_map^2,

with Huber's psi. Neither d_i nor m_i is squared, so that their noise does not bias k: it is a ratio of two weighted
means. s_image follows from the noise of the images, s_map, of the points' depths in the map, from the scatter.
"""

import math
from typing import NamedTuple

import numpy as np

from ceiling_dso_ros.dso.compute.scatter import median_scatter
from ceiling_dso_ros.dso.status import NO_SCALE, ScaleMeasurement

HUBER = 1.345  # standard deviations: nearly all of a normal distribution's information is kept
ITERATIONS = 20
CONVERGED = 1e-7  # of the logarithm
LEAST_POINTS = 30
CELLS = 8  # in a row of the image, and in a column: points of one cell have errors in common


class PointScales(NamedTuple):
    """Points as map and cameras see them.

    Attributes:
        mapped: (n,) float64 inverse depth in the map, 1/unit.
        measured: (n,) float64 inverse depth by the two cameras, 1/m.
        reach: (n,) float64 pixels per 1/m along the epipolar line.
        sigma: (n,) float64 pixels, of the place in the image.
        cell: (n,) int64 number of the part of the image in which the point is.
        is_new: (n,) bool, not used for a keyframe before.
        name: (n,) int64 identity of each.
    """

    mapped: np.ndarray
    measured: np.ndarray
    reach: np.ndarray
    sigma: np.ndarray
    cell: np.ndarray
    is_new: np.ndarray
    name: np.ndarray


def cells(u: np.ndarray, v: np.ndarray, width: int, height: int) -> np.ndarray:
    """(n,) int64 numbers of the parts of an image in which pixels (n,) are."""
    column = np.clip((u * (CELLS / width)).astype(np.int64), 0, CELLS - 1)
    return column + CELLS * np.clip((v * (CELLS / height)).astype(np.int64), 0, CELLS - 1)


def estimate_scale(points: PointScales, baseline_sigma: float, disparity_sigma_px: float) -> ScaleMeasurement:
    """The scale with its uncertainty; NO_SCALE where the points tell too little, or nothing new.

    Errors of a point's depth in the map stay while the point lives. So a point tells what it knows once: the variance
    by all points is divided by the share of the new ones. Points close to each other have errors in common: the
    variance is that of the sums over cells of the image.

    Args:
        points: all that were found.
        baseline_sigma: of the distance of the cameras, relative.
        disparity_sigma_px: of an error of the places of all points in the right image, along the line.
    """
    if len(points.mapped) < LEAST_POINTS:
        return NO_SCALE
    k = float(np.median(points.measured / points.mapped))
    for _ in range(ITERATIONS):
        residual = points.reach * (points.measured - k * points.mapped)
        sigma = _sigmas(residual, points.sigma)
        weight = np.minimum(1.0, HUBER * sigma / np.maximum(np.abs(residual), 1e-12)) / sigma**2
        mapped = float(np.sum(weight * points.reach * points.mapped))
        step = float(np.sum(weight * residual)) / mapped
        k += step
        if not (math.isfinite(k) and k > 0.0):
            return NO_SCALE
        if abs(step) < CONVERGED * k:
            break
    new = float(np.sum(weight[points.is_new])) / float(np.sum(weight))
    sums = np.bincount(points.cell, weight * points.reach * (points.measured - k * points.mapped))
    known = np.count_nonzero(np.bincount(points.cell))
    if new <= 0.0 or known < 2:
        return NO_SCALE
    # Of the sum's derivative by k: beyond the threshold psi is constant.
    inner = np.abs(residual) < HUBER * sigma
    slope = float(np.sum((points.reach * points.mapped / sigma**2)[inner]))
    variance = known / (known - 1.0) * float(np.sum(sums**2)) / (k * slope) ** 2
    common = math.hypot(baseline_sigma, disparity_sigma_px * float(np.sum(weight)) / (k * mapped))
    return ScaleMeasurement(-math.log(k), math.sqrt(variance / new), common)


def _sigmas(residual: np.ndarray, of_image: np.ndarray) -> np.ndarray:
    """Standard deviations of residuals: by the images' noise, and a part that all have and that their scatter tells."""
    scatter = float(median_scatter(residual))
    of_map = max(scatter**2 - float(np.median(of_image**2)), (0.1 * scatter) ** 2)
    return np.sqrt(of_image**2 + of_map)
