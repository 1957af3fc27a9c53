# SPDX-License-Identifier: BSD-3-Clause
"""Vignetting: a lens lets less light through towards the corners of the image."""

from typing import Optional, Tuple, Union

import numpy as np

from ceiling_dso_ros.dso.geometry.camera import PinholeCamera

TERMS = 2  # of ln V


class Vignette:
    """A share of light V that depends on the distance from the principal point: ln V = c1 rho^2 + c2 rho^4.

    rho is 1 at the corner that is farthest from the principal point. Immutable.

    Attributes:
        camera: of the images.
        coefficients: (c1, c2).
        inverse: (height, width) float32 1 / V; None where V is 1 everywhere.
    """

    def __init__(self, camera: PinholeCamera, coefficients: Tuple[float, float] = (0.0, 0.0)) -> None:
        self.camera = camera
        self.coefficients = coefficients
        self.inverse: Optional[np.ndarray] = None
        if any(coefficients):
            x = np.arange(camera.width) - camera.cx
            y = np.arange(camera.height) - camera.cy
            rho2 = (x**2 + y[:, None] ** 2) / largest_radius2(camera)
            self.inverse = np.exp(-log_share(coefficients, rho2)).astype(np.float32)


def log_share(coefficients: Union[np.ndarray, Tuple[float, float]], rho2: np.ndarray) -> np.ndarray:
    """The logarithm of V where the squared rho is rho2."""
    return (coefficients[0] + coefficients[1] * rho2) * rho2


def largest_radius2(camera: PinholeCamera) -> float:
    """Squared distance from the principal point to the farthest corner, pixels^2."""
    x = max(camera.cx, camera.width - 1 - camera.cx)
    y = max(camera.cy, camera.height - 1 - camera.cy)
    return float(x * x + y * y)
