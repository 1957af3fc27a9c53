# SPDX-License-Identifier: BSD-3-Clause
"""Lens models: projection of rays to pixels of a raw camera.

A ray is given by its ideal pinhole coordinates x = X/Z, y = Y/Z in the camera's optical frame.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Callable, Dict, Tuple

import numpy as np

from ceiling_dso_ros.io.limits import MOST_PIXELS

Coefficients = Tuple[float, ...]
Coordinates = Tuple[np.ndarray, np.ndarray]

# Rays at a larger angle to the optical axis are not used: at a depth of 1 the pinhole image would be 11 wide.
MAX_ANGLE = np.radians(80.0)

# Of the side of an image: a fisheye with 200 degrees has 0.29, and a lens with 2 degrees sees 4 cm of a ceiling.
SHORTEST_FOCAL, LONGEST_FOCAL = 0.15, 30.0


@dataclass(frozen=True)
class LensCamera:
    """A raw camera: a lens model, its intrinsics in pixels, and the image size.

    Attributes:
        model: a key of LENS_MODELS.
        fx, fy, cx, cy: pixels; the centre of the first pixel is (0, 0).
        distortion: coefficients of the model.
        width, height: pixels.
    """

    model: str
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: Coefficients
    width: int
    height: int

    def __post_init__(self) -> None:
        intrinsics = (self.fx, self.fy, self.cx, self.cy)
        if not np.isfinite((*intrinsics, *self.distortion)).all():
            raise ValueError("a number of the camera is not finite")
        if self.fx <= 0 or self.fy <= 0:
            raise ValueError(f"the focal lengths fx={self.fx:g} fy={self.fy:g} must be positive")
        if self.width <= 0 or self.height <= 0:
            raise ValueError(f"the image size {self.width}x{self.height} must be positive")
        if self.width * self.height > MOST_PIXELS:
            raise ValueError(f"the image size {self.width}x{self.height} is more than {MOST_PIXELS} pixels")

    @property
    def matrix(self) -> np.ndarray:
        """K of the raw image, (3, 3) float64."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def pixels(self, x: np.ndarray, y: np.ndarray) -> Coordinates:
        """Pixel coordinates (u, v) of rays (x, y, 1), of the same shape."""
        xd, yd = LENS_MODELS[self.model](self.distortion, x, y)
        return self.fx * xd + self.cx, self.fy * yd + self.cy

    def project(self, points: np.ndarray) -> np.ndarray:
        """Pixel coordinates (N, 2) of points (N, 3) in the optical frame, in front of the camera."""
        u, v = self.pixels(points[:, 0] / points[:, 2], points[:, 1] / points[:, 2])
        return np.stack([u, v], axis=1)

    def sees(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Whether rays (x, y, 1) hit the image so that bilinear interpolation needs no pixel outside it."""
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            u, v = self.pixels(x, y)
            inside = (u >= 0) & (u <= self.width - 1) & (v >= 0) & (v <= self.height - 1)
        return inside & (np.hypot(x, y) <= self.max_radius)

    @cached_property
    def max_radius(self) -> float:
        """Largest hypot(x, y) up to which the model is valid.

        Beyond this radius the polynomial models are not monotonic, and rays from outside would be projected into the
        image.
        """
        radii = np.tan(np.linspace(0.0, MAX_ANGLE, 4000))
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            distorted, _ = LENS_MODELS[self.model](self.distortion, radii, np.zeros_like(radii))
            folds = np.flatnonzero(~(np.diff(distorted) > 0))
        return float(radii[folds[0]] if len(folds) else radii[-1])


def check_whole_sensor(lens: LensCamera) -> None:
    """Refuse what cannot be the camera of a whole sensor: no lens has such a focal length, or its axis is not in view.

    Raises:
        ValueError: saying so.
    """
    for focal, side in ((lens.fx, lens.width), (lens.fy, lens.height)):
        if not SHORTEST_FOCAL * side <= focal <= LONGEST_FOCAL * side:
            raise ValueError(
                f"the focal lengths fx={lens.fx:g} fy={lens.fy:g} cannot be those of an image of "
                f"{lens.width}x{lens.height}"
            )
    if not (0 < lens.cx < lens.width - 1 and 0 < lens.cy < lens.height - 1):
        raise ValueError(
            f"the principal point ({lens.cx:g}, {lens.cy:g}) is outside the image of {lens.width}x{lens.height}"
        )


def _pinhole(_: Coefficients, x: np.ndarray, y: np.ndarray) -> Coordinates:
    return x, y


def _radial_tangential(coefficients: Coefficients, x: np.ndarray, y: np.ndarray) -> Coordinates:
    """Brown's model, k1 k2 p1 p2 [k3 [k4 k5 k6]] as in OpenCV: plumb_bob, and rational_polynomial with all eight."""
    k1, k2, p1, p2, k3, k4, k5, k6 = (*coefficients, *[0.0] * (8 - len(coefficients)))
    r2 = x * x + y * y
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return xd, yd


def _equidistant(coefficients: Coefficients, x: np.ndarray, y: np.ndarray) -> Coordinates:
    """Kannala and Brandt's fisheye, k1 k2 k3 k4 as in OpenCV."""
    k1, k2, k3, k4 = coefficients
    r = np.hypot(x, y)
    angle = np.arctan(r)
    a2 = angle * angle
    distorted = angle * (1 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4))))
    return _scale(x, y, r, distorted, 1.0)


def _field_of_view(coefficients: Coefficients, x: np.ndarray, y: np.ndarray) -> Coordinates:
    """Devernay and Faugeras's model of one angle omega, as in the TUM-mono data set (arXiv 1607.02555)."""
    (omega,) = coefficients
    slope = 2 * np.tan(omega / 2)
    r = np.hypot(x, y)
    return _scale(x, y, r, np.arctan(r * slope) / omega, slope / omega)


def _scale(x: np.ndarray, y: np.ndarray, r: np.ndarray, distorted: np.ndarray, at_centre: float) -> Coordinates:
    """Move (x, y) from radius r to the distorted radius; at_centre is the limit of their ratio."""
    centre = r < 1e-12
    ratio = np.where(centre, at_centre, distorted / np.where(centre, 1.0, r))
    return x * ratio, y * ratio


LENS_MODELS: Dict[str, Callable[[Coefficients, np.ndarray, np.ndarray], Coordinates]] = {
    "Pinhole": _pinhole,
    "RadTan": _radial_tangential,
    "EquiDistant": _equidistant,
    "FOV": _field_of_view,
}
