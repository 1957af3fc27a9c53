# SPDX-License-Identifier: BSD-3-Clause
"""Materials of the surfaces of a hall: each material paints a canvas of any size.

Reflectances are those of real ones (white paint 0.8, galvanised steel 0.5, concrete 0.35, black rubber 0.05);
contrasts are low, as they are on ceilings.
"""

from dataclasses import dataclass
from typing import Callable, Tuple

import numpy as np

from ceiling_dso_ros.simulation.rendering.canvas import Canvas


def _nothing(canvas: Canvas) -> None:
    """Leave the surface plain."""


@dataclass(frozen=True)
class Material:
    """How a surface looks.

    Attributes:
        base: reflectance 0..1, or the radiance of a luminous material, where 1 saturates the sensor at the reference
            exposure.
        paint: draws the pattern on a canvas filled with `base`.
        luminous: emits light and is not lit by other sources.
        coarseness: size of its finest details relative to the resolution of the camera.
    """

    base: float
    paint: Callable[[Canvas], None] = _nothing
    luminous: bool = False
    coarseness: float = 1.0

    def canvas(self, size_m: Tuple[float, float], texel_m: float, seed: Tuple[int, ...]) -> Canvas:
        """A painted canvas."""
        canvas = Canvas(size_m, texel_m, seed, self.base)
        self.paint(canvas)
        return canvas


def _scatter(canvas: Canvas, per_square_metre: float) -> np.ndarray:
    """Random places, (n, 2) metres."""
    count = canvas.rng.poisson(per_square_metre * canvas.size_m[0] * canvas.size_m[1])
    return canvas.rng.uniform((0.0, 0.0), canvas.size_m, (count, 2))


def _grid(canvas: Canvas, pitch_u: float, pitch_v: float) -> np.ndarray:
    """Places on a regular grid, (n, 2) metres."""
    u, v = (np.arange(pitch / 2, side, pitch) for pitch, side in zip((pitch_u, pitch_v), canvas.size_m))
    return np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)


def _every(canvas: Canvas, axis: int, pitch: float) -> np.ndarray:
    return np.arange(pitch, canvas.size_m[axis], pitch)


def _panels(canvas: Canvas, axis: int, pitch: float, spread: float) -> None:
    """Neighbouring panels differ a little in brightness and have a thin joint."""
    for start in np.arange(0.0, canvas.size_m[axis], pitch):
        corner, size = [0.0, 0.0], list(canvas.size_m)
        corner[axis], size[axis] = start, pitch
        canvas.rectangle((corner[0], corner[1]), (size[0], size[1]), 1.0 + canvas.rng.uniform(-spread, spread))
    canvas.stripes(axis, _every(canvas, axis, pitch), 0.012, 0.8)


def _stains(canvas: Canvas, per_square_metre: float, radius_m: float, gain: float) -> None:
    """Irregular blots: overlapping spots around a few centres."""
    for center in _scatter(canvas, per_square_metre):
        spread = radius_m * canvas.rng.uniform(0.4, 1.6)
        canvas.spots(center + canvas.rng.normal(0.0, spread, (5, 2)), 0.6 * spread, gain)


def _weathered(canvas: Canvas, amount: float) -> None:
    """Dirt and unevenness at all scales."""
    for wavelength, share in ((2.3, 1.0), (0.6, 0.7), (0.17, 0.5), (0.05, 0.35), (0.022, 0.25)):
        canvas.noise((wavelength, wavelength), amount * share)


def _deck(canvas: Canvas) -> None:
    """Trapezoidal sheet metal: ribs along v, overlaps, rows of screws, streaks."""
    _panels(canvas, 0, 1.0, 0.05)
    ribs = _every(canvas, 0, 0.25)
    canvas.stripes(0, ribs, 0.07, 0.86)
    canvas.stripes(0, ribs - 0.045, 0.014, 1.10)
    canvas.stripes(0, ribs + 0.045, 0.014, 0.93)
    canvas.stripes(1, _every(canvas, 1, 3.1), 0.015, 0.75)
    canvas.spots(_grid(canvas, 0.25, 1.55), 0.009, 0.6)
    canvas.noise((0.06, 1.4), 0.035)
    _weathered(canvas, 0.03)
    _stains(canvas, 0.12, 0.08, 0.88)


def _steel(canvas: Canvas) -> None:
    canvas.noise((0.5, 0.05), 0.05)
    _weathered(canvas, 0.05)
    _stains(canvas, 0.5, 0.03, 0.85)


def _bolted(canvas: Canvas) -> None:
    _steel(canvas)
    canvas.spots(_grid(canvas, 0.6, max(0.06, canvas.size_m[1] / 2)), 0.012, 0.6)


def _spiral_duct(canvas: Canvas) -> None:
    """Galvanised duct: a seam that winds around it, flanges every three metres, spangle."""
    _weathered(canvas, 0.06)
    canvas.noise((0.05, 0.05), 0.05)
    rise = 0.14
    turn = canvas.size_m[1]
    for start in np.arange(-rise, canvas.size_m[0], rise):
        canvas.curve(np.array([[start, 0.0], [start + rise, turn]]), 0.014, 0.78)
    canvas.stripes(0, _every(canvas, 0, 3.0), 0.05, 0.8)
    canvas.stripes(0, _every(canvas, 0, 3.0) + 0.035, 0.012, 1.15)


def _concrete(canvas: Canvas) -> None:
    _weathered(canvas, 0.07)
    canvas.stripes(0, _every(canvas, 0, 2.5), 0.015, 0.7)
    canvas.stripes(1, _every(canvas, 1, 1.25), 0.012, 0.8)
    canvas.spots(_scatter(canvas, 1.2), 0.015, 0.7)
    _stains(canvas, 0.15, 0.15, 0.9)


def _cladding(canvas: Canvas) -> None:
    """Wall of horizontal sandwich panels."""
    _panels(canvas, 1, 1.0, 0.05)
    canvas.stripes(0, _every(canvas, 0, 3.0), 0.02, 0.75)
    _weathered(canvas, 0.03)


def _mineral_tiles(canvas: Canvas) -> None:
    """Office ceiling: 60 cm tiles in a T-bar grid, the fissured tiles differ a little from each other."""
    pitch = 0.6
    for u in np.arange(0.0, canvas.size_m[0], pitch):
        for v in np.arange(0.0, canvas.size_m[1], pitch):
            canvas.rectangle((u, v), (pitch, pitch), 1.0 + canvas.rng.normal(0.0, 0.012))
    canvas.noise((0.03, 0.014), 0.022)
    canvas.noise((0.014, 0.03), 0.014)
    canvas.noise((1.7, 1.7), 0.015)
    _stains(canvas, 0.04, 0.10, 0.93)
    for axis in (0, 1):
        canvas.stripes(axis, _every(canvas, axis, pitch), 0.034, 0.8)
        canvas.stripes(axis, _every(canvas, axis, pitch), 0.020, 1.35)


def _fine_plaster(canvas: Canvas) -> None:
    """Painted plaster: hardly anything to see but roller marks, hairline cracks and a few spots."""
    canvas.noise((0.25, 1.3), 0.006)
    canvas.noise((0.9, 0.9), 0.008)
    canvas.noise((0.07, 0.07), 0.007)
    canvas.noise((0.025, 0.025), 0.006)
    canvas.spots(_scatter(canvas, 0.25), 0.012, 0.85)
    _stains(canvas, 0.015, 0.12, 0.96)
    for start in _scatter(canvas, 0.03):
        heading = canvas.rng.uniform(0, 2 * np.pi) + np.cumsum(canvas.rng.normal(0.0, 0.25, 40))
        canvas.curve(start + np.cumsum(0.05 * np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0), 0.003, 0.6)


def _planks(canvas: Canvas) -> None:
    canvas.noise((0.9, 0.03), 0.12)
    _weathered(canvas, 0.05)
    _panels(canvas, 1, 0.14, 0.1)


def _cardboard(canvas: Canvas) -> None:
    canvas.stripes(1, np.array([canvas.size_m[1] / 2]), 0.06, 1.25)
    canvas.rectangle((0.1 * canvas.size_m[0], 0.15 * canvas.size_m[1]), (0.2, 0.14), 1.6)
    _weathered(canvas, 0.04)


def _cables(canvas: Canvas) -> None:
    """Bundles of cables along u."""
    canvas.noise((3.0, 0.02), 0.35)
    canvas.noise((0.8, 0.03), 0.2)


def _skylight(canvas: Canvas) -> None:
    canvas.noise((0.8, 0.8), 0.05)
    canvas.stripes(1, _every(canvas, 1, 0.08), 0.02, 0.93)


def _grille(canvas: Canvas) -> None:
    canvas.stripes(1, _every(canvas, 1, 0.05), 0.025, 0.25)


def _honeycomb(canvas: Canvas) -> None:
    """Bright louvre of an office lamp."""
    for axis in (0, 1):
        canvas.stripes(axis, _every(canvas, axis, 0.15), 0.02, 0.55)


def lettering(text: str) -> Material:
    """A dark board with bright letters."""

    def paint(canvas: Canvas) -> None:
        canvas.text(text, 8.0)
        width, height = canvas.size_m
        canvas.stripes(0, np.array([0.0, width]), 0.05, 6.0)
        canvas.stripes(1, np.array([0.0, height]), 0.05, 6.0)

    return Material(0.08, paint)


DECK = Material(0.46, _deck)
STEEL = Material(0.24, _steel)
LIGHT_STEEL = Material(0.55, _steel, coarseness=1.5)
BOLTED_STEEL = Material(0.22, _bolted)
GALVANISED = Material(0.62, _steel)
DUCT = Material(0.60, _spiral_duct)
CONCRETE = Material(0.38, _concrete)
CLADDING = Material(0.50, _cladding, coarseness=2.0)
MINERAL_TILES = Material(0.62, _mineral_tiles)
PLASTER = Material(0.65, _fine_plaster, coarseness=1.3)
WOOD = Material(0.35, _planks, coarseness=3.0)
PAINTED_WALL = Material(0.65, _fine_plaster, coarseness=4.0)
CARDBOARD = Material(0.40, _cardboard, coarseness=3.0)
CABLES = Material(0.07, _cables)
BLACK = Material(0.05, _grille)
WHITE = Material(0.75)
OUTLET = Material(0.55, _grille)
FLOOR = Material(0.35, _concrete, luminous=True, coarseness=2.0)  # it emits no light onto other surfaces
BRASS = Material(0.45)
LAMP = Material(5.0, luminous=True)
LOUVRE = Material(2.2, _honeycomb, luminous=True)
SKYLIGHT = Material(1.25, _skylight, luminous=True)
