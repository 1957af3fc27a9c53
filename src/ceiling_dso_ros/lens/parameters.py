# SPDX-License-Identifier: BSD-3-Clause
"""The six numbers of a lens that a drive can correct, and their derivatives.

They are the model's own, so that a corrected lens is a lens of the same model: fx, fy, cx, cy and the first two radial
coefficients. A pinhole becomes RadTan. The model FOV has one coefficient, omega, in the place of k1.
"""

from dataclasses import replace
from typing import Tuple

import numpy as np

from ceiling_dso_ros.io.lens_models import LENS_MODELS, LensCamera

PARAMETERS = 6
STEP = 1e-6  # of numeric derivatives
NEWTON_STEPS = 12
CLOSE_ENOUGH = 1e-12


def correctable(lens: LensCamera) -> LensCamera:
    """The same lens in a model that has radial coefficients."""
    if lens.model == "Pinhole":
        return replace(lens, model="RadTan", distortion=(0.0, 0.0, 0.0, 0.0))
    return lens


def names_of(lens: LensCamera) -> Tuple[str, ...]:
    """Names of the numbers that can be corrected."""
    return ("fx", "fy", "cx", "cy", *(("omega",) if lens.model == "FOV" else ("k1", "k2")))


def vector_of(lens: LensCamera) -> np.ndarray:
    """(6,) float64: fx, fy, cx, cy in pixels, and the first two coefficients; 0 in the place of one that is missing."""
    radial = (*lens.distortion, 0.0, 0.0)[:2]
    return np.array([lens.fx, lens.fy, lens.cx, lens.cy, *radial])


def with_vector(lens: LensCamera, vector: np.ndarray) -> LensCamera:
    """The lens with other numbers, (6,).

    Raises:
        ValueError: they describe no lens.
    """
    fx, fy, cx, cy, *radial = vector.tolist()
    count = min(len(radial), len(lens.distortion))
    distortion = (*radial[:count], *lens.distortion[count:])
    return replace(lens, fx=fx, fy=fy, cx=cx, cy=cy, distortion=distortion)


def pixels_of(lens: LensCamera, rays: np.ndarray) -> np.ndarray:
    """Raw pixels (N, 2) of rays (x, y, 1), given as (N, 2)."""
    return np.column_stack(lens.pixels(rays[:, 0], rays[:, 1]))


def by_ray(lens: LensCamera, rays: np.ndarray) -> np.ndarray:
    """(N, 2, 2) derivatives of the pixels by the rays, (N, 2)."""
    steps = STEP * np.eye(2)
    columns = [(pixels_of(lens, rays + step) - pixels_of(lens, rays - step)) / (2.0 * STEP) for step in steps]
    return np.stack(columns, axis=-1)


def by_parameters(lens: LensCamera, rays: np.ndarray) -> np.ndarray:
    """(N, 2, 6) derivatives of the pixels by the six numbers, at rays (N, 2)."""
    x, y = rays.T
    xd, yd = LENS_MODELS[lens.model](lens.distortion, x, y)
    result = np.zeros((len(rays), 2, PARAMETERS))
    result[:, 0, 0], result[:, 1, 1] = xd, yd
    result[:, 0, 2] = result[:, 1, 3] = 1.0
    vector = vector_of(lens)
    for number in range(4, 4 + min(2, len(lens.distortion))):
        step = STEP * np.eye(PARAMETERS)[number]
        more, less = (pixels_of(with_vector(lens, vector + sign * step), rays) for sign in (1.0, -1.0))
        result[:, :, number] = (more - less) / (2.0 * STEP)
    return result


def rays_of(lens: LensCamera, pixels: np.ndarray, guess: np.ndarray) -> np.ndarray:
    """Rays (N, 2) that a lens shows at raw pixels (N, 2), by Newton's method from a guess (N, 2)."""
    rays = guess
    for _ in range(NEWTON_STEPS):
        step = np.linalg.solve(by_ray(lens, rays), (pixels - pixels_of(lens, rays))[:, :, None])[:, :, 0]
        rays = rays + step
        if np.abs(step).max(initial=0.0) < CLOSE_ENOUGH:
            break
    return rays
