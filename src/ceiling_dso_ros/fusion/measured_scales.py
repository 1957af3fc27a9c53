# SPDX-License-Identifier: BSD-3-Clause
"""The scales that a second camera has measured over a whole drive, see `metre`, for `smoothing`."""

from typing import Tuple

import numpy as np

from ceiling_dso_ros.dso.status import ScaleMeasurement
from ceiling_dso_ros.fusion.config import FusionConfig
from ceiling_dso_ros.fusion.metre import metre_sigma


class MeasuredScales:
    """Measurements of (N,) MOTION; false if there are none.

    Attributes:
        metre_sigma: standard deviation of n before; nan without measurements.
    """

    def __init__(self, motions: np.ndarray, config: FusionConfig) -> None:
        self._measured = motions["has_stereo"]
        self._log_scale, sigma, _ = motions["stereo"].T
        self._information = np.where(self._measured, np.where(self._measured, sigma, 1.0) ** -2.0, 0.0)
        self._threshold = config.visual.robust_threshold
        self.metre_sigma = np.nan
        if self:
            first = ScaleMeasurement(*motions["stereo"][self._measured][0].tolist())
            self.metre_sigma = metre_sigma(first, config.wheels.radius_sigma)

    def __bool__(self) -> bool:
        return bool(self._measured.any())

    def error(self, log_scales: np.ndarray, metre: float) -> float:
        """Sum of the squared residuals at (N,) log-scales and n; of outliers only their size counts (Huber)."""
        sizes = np.sqrt(self._information) * np.abs(log_scales - metre - self._log_scale)
        within = np.minimum(sizes, self._threshold)
        return float(np.sum(within * (2.0 * sizes - within)))

    def pull(self, log_scales: np.ndarray, metre: float) -> Tuple[np.ndarray, np.ndarray]:
        """Gradient of half the error by the log-scales, (N,), and the information of each measurement, (N,)."""
        residuals = log_scales - metre - self._log_scale
        sizes = np.sqrt(self._information) * np.abs(residuals)
        weights = self._information * self._threshold / np.maximum(sizes, self._threshold)
        return weights * residuals, weights
