# SPDX-License-Identifier: BSD-3-Clause
"""The pinhole camera that the odometry works on, after undistortion."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class PinholeCamera:
    """Intrinsics of an ideal pinhole image.

    A pixel's integer coordinate is its centre, so the image covers [-0.5, width - 0.5] x [-0.5, height - 0.5].

    Attributes:
        fx, fy: focal lengths in pixels, positive.
        cx, cy: principal point in pixels.
        width, height: size in pixels.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

    def __post_init__(self) -> None:
        values = (self.fx, self.fy, self.cx, self.cy)
        if not all(np.isfinite(values)) or self.fx <= 0 or self.fy <= 0:
            raise ValueError(f"camera: fx fy cx cy must be finite and fx, fy positive, not {values}")
        if self.width < 64 or self.height < 64:
            raise ValueError(f"camera: image {self.width}x{self.height} is too small, at least 64x64 is needed")

    @property
    def matrix(self) -> np.ndarray:
        """K, (3, 3) float64."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def parameters(self) -> np.ndarray:
        """(fx, fy, cx, cy), (4,) float64."""
        return np.array([self.fx, self.fy, self.cx, self.cy])
