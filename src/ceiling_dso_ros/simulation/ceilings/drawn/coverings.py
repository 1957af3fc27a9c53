# SPDX-License-Identifier: BSD-3-Clause
"""What the underside of a roof is made of, with random sizes, contrasts and dirt; u runs along the hall."""

from typing import Callable, Dict, NamedTuple

import numpy as np

from ceiling_dso_ros.simulation.rendering.canvas import Canvas
from ceiling_dso_ros.simulation.rendering.materials import Material

Paint = Callable[[Canvas], None]
WEATHER_M = ((2.3, 1.0), (0.6, 0.7), (0.17, 0.5), (0.05, 0.35), (0.022, 0.25))  # wavelength, share


class Covering(NamedTuple):
    """A material and how it was drawn.

    Attributes:
        kind: a name of COVERINGS.
        material: as it is painted.
        contrast: of its pattern, relative to a usual one.
        dirt: amplitude of unevenness and stains, relative to reflectance; 0 for a strictly periodic pattern.
    """

    kind: str
    material: Material
    contrast: float
    dirt: float


class _Pattern:
    """Draws the regular part of a pattern; gains are for a contrast of 1."""

    def __init__(self, canvas: Canvas, contrast: float) -> None:
        self._canvas, self._contrast = canvas, contrast

    def gain(self, gain: float) -> float:
        """A gain at this contrast."""
        return max(1.0 + self._contrast * (gain - 1.0), 0.05)

    def lines(self, axis: int, pitch: float, width: float, gain: float, shift: float = 0.0) -> None:
        """Lines at a regular distance."""
        positions = np.arange(shift, self._canvas.size_m[axis] + pitch, pitch)
        self._canvas.stripes(axis, positions, width, self.gain(gain))

    def dots(self, pitch_u: float, pitch_v: float, radius: float, gain: float) -> None:
        """Spots on a grid."""
        u, v = (np.arange(pitch / 2, side, pitch) for pitch, side in zip((pitch_u, pitch_v), self._canvas.size_m))
        self._canvas.spots(np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2), radius, self.gain(gain))

    def fields(self, pitch_u: float, pitch_v: float, spread: float, bond: bool = False) -> None:
        """Neighbouring fields differ a little in brightness; in a bond every second row is shifted by half."""
        for row, v in enumerate(np.arange(0.0, self._canvas.size_m[1], pitch_v)):
            start = -0.5 * pitch_u if bond and row % 2 else 0.0
            for u in np.arange(start, self._canvas.size_m[0], pitch_u):
                gain = 1.0 + self._contrast * self._canvas.rng.uniform(-spread, spread)
                self._canvas.rectangle((u, v), (pitch_u, pitch_v), gain)


def _sheet_metal(rng: np.random.Generator, spread: float) -> Callable[[_Pattern], None]:
    rib, panel, overlap = rng.uniform(0.15, 0.35), rng.uniform(0.7, 1.2), rng.uniform(2.5, 6.0)

    def paint(pattern: _Pattern) -> None:
        pattern.fields(panel, overlap, 0.05 * spread)
        pattern.lines(0, rib, 0.3 * rib, 0.86)
        pattern.lines(0, rib, 0.05 * rib, 1.1, 0.2 * rib)
        pattern.lines(0, rib, 0.05 * rib, 0.92, 0.45 * rib)
        pattern.lines(1, overlap, 0.015, 0.75)
        pattern.dots(rib, 0.5 * overlap, 0.009, 0.6)

    return paint


def _concrete(rng: np.random.Generator, spread: float) -> Callable[[_Pattern], None]:
    boards_u, boards_v, anchors = rng.uniform(1.2, 3.0), rng.uniform(0.5, 1.5), rng.uniform(0.6, 1.2)

    def paint(pattern: _Pattern) -> None:
        pattern.fields(boards_u, boards_v, 0.04 * spread)
        pattern.lines(0, boards_u, 0.012, 0.7)
        pattern.lines(1, boards_v, 0.010, 0.8)
        pattern.dots(anchors, anchors, 0.014, 0.7)

    return paint


def _tiles(rng: np.random.Generator, spread: float) -> Callable[[_Pattern], None]:
    u = rng.choice([0.6, 0.625, 1.2])
    v = rng.choice([0.6, 0.625]) if u > 1.0 else u

    def paint(pattern: _Pattern) -> None:
        pattern.fields(u, v, 0.02 * spread)
        for axis, pitch in enumerate((u, v)):
            pattern.lines(axis, pitch, 0.034, 0.8)
            pattern.lines(axis, pitch, 0.020, 1.35)
        pattern.dots(0.05, 0.05, 0.004, 0.85)

    return paint


def _insulation(rng: np.random.Generator, spread: float) -> Callable[[_Pattern], None]:
    strip, wire = rng.uniform(0.9, 1.6), rng.uniform(0.3, 0.6)

    def paint(pattern: _Pattern) -> None:
        pattern.fields(20.0, strip, 0.05 * spread)
        pattern.lines(1, strip, 0.05, 0.85)
        pattern.lines(0, wire, 0.008, 0.8)

    return paint


def _timber(rng: np.random.Generator, spread: float) -> Callable[[_Pattern], None]:
    plank, length = rng.uniform(0.09, 0.22), rng.uniform(1.5, 4.0)

    def paint(pattern: _Pattern) -> None:
        pattern.fields(length, plank, 0.12 * spread, bond=True)
        pattern.lines(1, plank, 0.008, 0.55)

    return paint


def _corrugated(rng: np.random.Generator, spread: float) -> Callable[[_Pattern], None]:
    wave, sheet = rng.uniform(0.06, 0.18), rng.uniform(0.8, 1.1)

    def paint(pattern: _Pattern) -> None:
        pattern.fields(sheet, 2.5, 0.04 * spread)
        pattern.lines(0, wave, 0.4 * wave, 0.82)
        pattern.lines(0, wave, 0.2 * wave, 1.12, 0.5 * wave)
        pattern.lines(1, 2.5, 0.02, 0.7)

    return paint


def _brick(rng: np.random.Generator, spread: float) -> Callable[[_Pattern], None]:
    length, height = rng.uniform(0.22, 0.30), rng.uniform(0.065, 0.12)

    def paint(pattern: _Pattern) -> None:
        pattern.fields(length, height, 0.15 * spread, bond=True)
        pattern.lines(1, height, 0.012, 1.4)

    return paint


COVERINGS: Dict[str, Callable[[np.random.Generator, float], Callable[[_Pattern], None]]] = {
    "sheet metal": _sheet_metal,
    "concrete": _concrete,
    "tiles": _tiles,
    "insulation": _insulation,
    "timber": _timber,
    "corrugated": _corrugated,
    "brick": _brick,
}
REFLECTANCES = {
    "sheet metal": (0.35, 0.7),
    "concrete": (0.25, 0.5),
    "tiles": (0.5, 0.75),
    "insulation": (0.45, 0.8),
    "timber": (0.2, 0.45),
    "corrugated": (0.3, 0.65),
    "brick": (0.2, 0.45),
}
FINE = {"brick": 1.5, "timber": 1.5, "corrugated": 1.3}  # many small fields are painted a little coarser


def draw_covering(rng: np.random.Generator, is_periodic: bool, wide_m: float) -> Covering:
    """Any covering.

    Args:
        rng: for all choices.
        is_periodic: it repeats strictly: no field differs from the next, and there is no dirt.
        wide_m: what the camera sees at once; brick is painted for small halls alone.
    """
    kinds = [kind for kind in COVERINGS if kind != "brick" or wide_m < 12.0]
    kind = str(rng.choice(kinds))
    base, contrast = float(rng.uniform(*REFLECTANCES[kind])), float(np.exp(rng.uniform(np.log(0.35), np.log(1.6))))
    dirt = 0.0 if is_periodic else float(np.exp(rng.uniform(np.log(0.006), np.log(0.08))))
    stains, radius = (0.0 if is_periodic else rng.uniform(0.0, 0.25)), rng.uniform(0.05, 0.2)
    pattern = COVERINGS[kind](rng, 0.0 if is_periodic else 1.0)

    def paint(canvas: Canvas) -> None:
        pattern(_Pattern(canvas, contrast))
        if is_periodic:
            return
        for wavelength, share in WEATHER_M:
            canvas.noise((wavelength, wavelength), dirt * share)
        for center in canvas.rng.uniform((0, 0), canvas.size_m, (canvas.rng.poisson(stains * _area(canvas)), 2)):
            places = center + canvas.rng.normal(0.0, radius, (5, 2))
            canvas.spots(places, 0.6 * radius, 1.0 - min(2.0 * dirt, 0.5))

    return Covering(kind, Material(base, paint, coarseness=FINE.get(kind, 1.0)), contrast, dirt)


def _area(canvas: Canvas) -> float:
    return canvas.size_m[0] * canvas.size_m[1]
