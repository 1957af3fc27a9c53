# SPDX-License-Identifier: BSD-3-Clause
"""Chooses the pinhole camera to which raw images are undistorted.

A view is the rectangle (left, right, top, bottom) of ideal coordinates x = X/Z, y = Y/Z at the centres of the outermost
pixels, (4,) float64.
"""

from typing import Callable, Tuple

import numpy as np

from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.io.lens_models import LensCamera

BISECTIONS = 52  # the bits of a float64
SAMPLES = 1001  # points checked on each side of a view
MIDDLE_STEPS = 100  # of a fixed-point iteration that halves its error at least
NO_LENS = "the distortion coefficients are those of no lens: it would see next to nothing"


def crop_camera(lens: LensCamera, width: int, height: int) -> PinholeCamera:
    """The pinhole of the largest view, width x height pixels, that shows nothing but the raw image.

    Largest means that no side can be moved outwards.

    Raises:
        ValueError: the coefficients describe no lens, or the size is too small.
    """
    if lens.model == "Pinhole" and (width, height) == (lens.width, lens.height):
        return PinholeCamera(lens.fx, lens.fy, lens.cx, lens.cy, width, height)

    axes = np.array([[-1.0, 0.0], [1.0, 0.0], [0.0, -1.0], [0.0, 1.0]])
    centre = _centre(lens)
    furthest = centre.repeat(2) + _reach(lens, axes, centre) * axes.sum(axis=1)
    view = _grow(lens, centre.repeat(2), furthest, furthest)
    for side in range(4):
        wider = view.copy()
        wider[side] = furthest[side]
        view = _grow(lens, view, wider, furthest)
    return _pinhole(view, width, height)


def full_camera(lens: LensCamera, width: int, height: int) -> PinholeCamera:
    """The pinhole of width x height pixels that shows all of the raw image, up to MAX_ANGLE off the axis.

    Raises:
        ValueError: the coefficients describe no lens, or the size is too small.
    """
    if lens.model == "Pinhole" and (width, height) == (lens.width, lens.height):
        return PinholeCamera(lens.fx, lens.fy, lens.cx, lens.cy, width, height)

    u, v = _border(np.arange(lens.width), np.arange(lens.height))
    directions = np.stack([(u - lens.cx) / lens.fx, (v - lens.cy) / lens.fy], axis=1)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    edge = directions * _reach(lens, directions)[:, None]
    (left, top), (right, bottom) = edge.min(axis=0), edge.max(axis=0)
    return _pinhole(np.array([left, right, top, bottom]), width, height)


def _centre(lens: LensCamera) -> np.ndarray:
    """A point (2,) from which the view grows: the optical axis, or the middle of an image that does not show it.

    Raises:
        ValueError: the coefficients describe no lens.
    """
    if lens.sees(np.zeros(1), np.zeros(1)).all():
        return np.zeros(2)
    focal, middle = np.array([lens.fx, lens.fy]), np.array([lens.width - 1, lens.height - 1]) / 2
    point = np.zeros(2)
    for _ in range(MIDDLE_STEPS):
        point = point + (middle - np.array(lens.pixels(*point))) / focal
    if not lens.sees(*point[:, None]).all():
        raise ValueError(NO_LENS)
    return point


def _reach(lens: LensCamera, directions: np.ndarray, centre: np.ndarray = np.zeros(2)) -> np.ndarray:
    """Extent of the raw image from a point (2,), by default the optical axis, along directions (N, 2): (N,).

    Points and extents are ideal coordinates.
    """
    furthest = np.full(len(directions), lens.max_radius + np.hypot(*centre))
    return furthest * _bisect(lambda s: lens.sees(*(centre + directions * (s * furthest)[:, None]).T), len(directions))


def _grow(lens: LensCamera, view: np.ndarray, wider: np.ndarray, furthest: np.ndarray) -> np.ndarray:
    """Extend a view towards a wider one as far as the raw image shows its whole border."""
    # The samples do not move while the view grows: a sample at the edge of the image must stay there.
    x, y = (np.linspace(first, last, SAMPLES) for first, last in furthest.reshape(2, 2))

    def is_seen(s: np.ndarray) -> np.ndarray:
        left, right, top, bottom = view + s * (wider - view)
        return lens.sees(*_border(np.clip(x, left, right), np.clip(y, top, bottom))).all(keepdims=True)

    return view + _bisect(is_seen, 1) * (wider - view)


def _bisect(holds: Callable[[np.ndarray], np.ndarray], count: int) -> np.ndarray:
    """The largest s in [0, 1], (count,), for which holds(s), where holds is true up to some s and false from there."""
    low, high = np.zeros(count), np.ones(count)
    low = np.where(holds(high), high, low)
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        good = holds(middle)
        low, high = np.where(good, middle, low), np.where(good, high, middle)
    return low


def _border(x: np.ndarray, y: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """Coordinates of all points on the border of the grid that x and y span."""
    return (
        np.concatenate([x, x, np.full_like(y, x[0]), np.full_like(y, x[-1])]),
        np.concatenate([np.full_like(x, y[0]), np.full_like(x, y[-1]), y, y]),
    )


def _pinhole(view: np.ndarray, width: int, height: int) -> PinholeCamera:
    left, right, top, bottom = view
    if right - left < 1e-3 or bottom - top < 1e-3:
        raise ValueError(NO_LENS)
    fx, fy = (width - 1) / (right - left), (height - 1) / (bottom - top)
    return PinholeCamera(float(fx), float(fy), float(-left * fx), float(-top * fy), width, height)
