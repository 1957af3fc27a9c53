# SPDX-License-Identifier: BSD-3-Clause
"""Shapes of roofs. They are the same all along the hall (x): the height depends on y alone."""

from dataclasses import dataclass
from typing import Callable, Dict, List, Tuple

import numpy as np

from ceiling_dso_ros.simulation.rendering import materials
from ceiling_dso_ros.simulation.rendering.geometry import Point, Surface, polygon
from ceiling_dso_ros.simulation.rendering.materials import Material

VAULT_STRIPS = 14


@dataclass(frozen=True)
class Roof:
    """A roof over a rectangular hall.

    Attributes:
        kind: a name of ROOFS.
        size_m: length (x) and width (y) of the hall.
        section: (n, 2) y and height of the corners of its section, y ascending; two corners with the same y are a
            vertical face of glass.
    """

    kind: str
    size_m: Tuple[float, float]
    section: np.ndarray

    @property
    def lowest_m(self) -> float:
        """Height of its lowest line."""
        return float(self.section[:, 1].min())

    @property
    def highest_m(self) -> float:
        """Height of its highest line."""
        return float(self.section[:, 1].max())

    def height(self, y: float) -> float:
        """Height over a line along the hall, metres."""
        return float(np.interp(y, *self.section.T))

    def planes(self) -> List[Tuple[float, float]]:
        """The parts of y over which the roof is one plane."""
        y = self.section[:, 0]
        return [(float(a), float(b)) for a, b in zip(y[:-1], y[1:]) if b > a]

    def surfaces(self, material: Material) -> List[Surface]:
        """Its underside, and the glass of its vertical faces."""
        half = self.size_m[0] / 2
        surfaces = []
        for (y0, z0), (y1, z1) in zip(self.section[:-1], self.section[1:]):
            is_glass = y0 == y1
            corners: List[Point] = [(-half, y0, z0), (-half, y1, z1), (half, y1, z1), (half, y0, z0)]
            surfaces.append(polygon(corners, materials.SKYLIGHT if is_glass else material, along=(1.0, 0.0, 0.0)))
        return surfaces

    def patch(self, x: Tuple[float, float], y: Tuple[float, float], material: Material, below_m: float) -> Surface:
        """A rectangle seen from above, a little below one plane of the roof."""
        (x0, x1), (y0, y1) = x, y
        z0, z1 = self.height(y0) - below_m, self.height(y1) - below_m
        corners: List[Point] = [(x0, y0, z0), (x0, y1, z1), (x1, y1, z1), (x1, y0, z0)]
        return polygon(corners, material, along=(1.0, 0.0, 0.0))


def _flat(rng: np.random.Generator, half: float, height: float) -> List[Tuple[float, float]]:
    return [(-half, height), (half, height)]


def _pitched(rng: np.random.Generator, half: float, height: float) -> List[Tuple[float, float]]:
    ridge = rng.choice([0.0, 0.0, rng.uniform(-0.4, 0.4)]) * half
    rise = half * np.tan(np.radians(rng.uniform(4.0, 25.0)))
    return [(-half, height), (ridge, height + rise), (half, height)]


def _saw_tooth(rng: np.random.Generator, half: float, height: float) -> List[Tuple[float, float]]:
    teeth = rng.integers(3, 6)
    pitch = 2 * half / teeth
    rise = pitch * rng.uniform(0.15, 0.4)
    starts = -half + pitch * np.arange(teeth)
    return [corner for y in starts for corner in ((float(y), height), (float(y + pitch), height + rise))] + [
        (half, height)
    ]


def _vaulted(rng: np.random.Generator, half: float, height: float) -> List[Tuple[float, float]]:
    rise = half * rng.uniform(0.2, 0.5)
    radius = (half**2 + rise**2) / (2 * rise)
    y = np.linspace(-half, half, VAULT_STRIPS + 1)
    z = height + np.sqrt(radius**2 - y**2) - (radius - rise)
    return [(float(a), float(b)) for a, b in zip(y, z)]


ROOFS: Dict[str, Callable[[np.random.Generator, float, float], List[Tuple[float, float]]]] = {
    "flat": _flat,
    "pitched": _pitched,
    "saw_tooth": _saw_tooth,
    "vaulted": _vaulted,
}


def draw_roof(rng: np.random.Generator, size_m: Tuple[float, float], height_m: float) -> Roof:
    """A roof of any kind whose eaves are at a height; a low one is flat, as in offices."""
    kind = "flat" if height_m < 3.0 else str(rng.choice(list(ROOFS), p=[0.4, 0.25, 0.15, 0.2]))
    section = np.array(ROOFS[kind](rng, size_m[1] / 2, height_m))
    section[:, 0] = np.round(section[:, 0], 6)
    return Roof(kind, size_m, section)
