# SPDX-License-Identifier: BSD-3-Clause
"""How far values scatter, whatever a few of them are."""

from typing import Optional

import numpy as np

OF_NORMAL = 1.4826  # standard deviation of a normal distribution by the median of its absolute values


def median_scatter(residuals: np.ndarray, axis: Optional[int] = None) -> np.ndarray:
    """Standard deviation about zero of those of (...) float64 that are normal, by the median of all absolute values."""
    return OF_NORMAL * np.median(np.abs(residuals), axis=axis)
