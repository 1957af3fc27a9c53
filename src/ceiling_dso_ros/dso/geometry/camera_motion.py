# SPDX-License-Identifier: BSD-3-Clause
"""A motion of the camera predicted by other sensors: a hypothesis for the tracking, never a measurement.

What is used of it as knowledge is only the plane in which the camera moves.
"""

from dataclasses import dataclass, replace
from typing import Iterator, Optional

import numpy as np

from ceiling_dso_ros.dso.geometry import se3

SIGMAS = 2.0  # distance of the alternatives from the most likely motion, in sigmas
MIN_SPREAD = 0.005  # rad, or units at a depth of about one: from a smaller distance tracking converges by itself


@dataclass(frozen=True)
class CameraMotion:
    """Motion of the camera between two images.

    Attributes:
        T_start_end: (4, 4) float64 pose of the camera at the later image seen from the earlier, translation in the
            unit of the segment.
        covariance: (6, 6) float64 of (translation, rotation), a left increment on T_start_end.
        metric: the translation is in metres instead, since the unit of the segment is not known to who predicts.
        normal: (3,) float64 unit normal, in the camera's frame, of the plane in which the camera moves; None where it
            may move otherwise.
    """

    T_start_end: np.ndarray
    covariance: np.ndarray
    metric: bool = False
    normal: Optional[np.ndarray] = None

    def in_unit(self, metres_per_unit: float, relative_sigma: float) -> "CameraMotion":
        """A metric motion in the unit of a segment.

        Args:
            metres_per_unit: the unit of the segment.
            relative_sigma: its standard deviation, relative.
        """
        T_start_end = self.T_start_end.copy()
        T_start_end[:3, 3] /= metres_per_unit
        to_unit = np.diag(np.repeat([1.0 / metres_per_unit, 1.0], 3))
        covariance = to_unit @ self.covariance @ to_unit
        covariance[:3, :3] += relative_sigma**2 * np.outer(T_start_end[:3, 3], T_start_end[:3, 3])
        return replace(self, T_start_end=T_start_end, covariance=covariance, metric=False)

    def alternatives(self) -> Iterator[np.ndarray]:
        """T_start_end (4, 4) two sigma away along the wide axes of the covariance, the widest first.

        If the scale is uncertain, these are a shorter and a longer translation.
        """
        variances, axes = np.linalg.eigh(self.covariance)
        for variance, axis in zip(variances[::-1], axes.T[::-1]):
            spread = SIGMAS * np.sqrt(max(variance, 0.0))
            if spread < MIN_SPREAD:
                return
            for side in (spread, -spread):
                yield se3.exp(side * axis) @ self.T_start_end
