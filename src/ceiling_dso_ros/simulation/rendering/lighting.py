# SPDX-License-Identifier: BSD-3-Clause
"""Light in a hall: the floor reflects light upward, lamps emit light, and everything in between casts soft shadows.

The floor is cut into patches of 1.5 m, each a small source with its own shadow map ("instant radiosity", Keller 1997).
The light does not depend on the camera's position, so it is computed once and stored in the textures.
"""

from typing import NamedTuple, Sequence

import numpy as np

from ceiling_dso_ros.simulation.rendering.lighting_kernels import add_light
from ceiling_dso_ros.simulation.rendering.raster_kernels import Mesh, rasterise

PATCH_M = 1.5
MAP_SIZE = 384
MAP_FOCAL = 0.5 * MAP_SIZE / np.tan(np.radians(68.0))
AMBIENT = 0.12


class Source(NamedTuple):
    """A small source of light that shines upward.

    Attributes:
        position: (3,) metres.
        power: irradiance one metre above it, where 1 makes a white surface saturate the sensor.
        floor: a patch of floor rather than a lamp.
    """

    position: np.ndarray
    power: float
    floor: bool


def floor_sources(size_m: Sequence[float], rng: np.random.Generator) -> Sequence[Source]:
    """Sources for the lit floor of a hall (length, width): an irradiance of about 1 far above its middle."""
    columns, rows = (max(1, round(side / PATCH_M)) for side in size_m)
    area = size_m[0] * size_m[1] / (columns * rows)
    xs, ys = ((np.arange(n) + 0.5) / n * side - side / 2 for n, side in ((columns, size_m[0]), (rows, size_m[1])))
    brightness = rng.uniform(0.6, 1.4, (rows, columns))
    return [
        Source(np.array([x, y, 0.0]), area / np.pi * brightness[j, i], True)
        for j, y in enumerate(ys)
        for i, x in enumerate(xs)
    ]


def irradiance(mesh: Mesh, sources: Sequence[Source], points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Light that arrives at points of the hall.

    Args:
        mesh: geometry that casts shadows.
        sources: the lights.
        points: (N, 3) metres.
        normals: (N, 3) unit vectors.

    Returns:
        (N,) float64.
    """
    light = AMBIENT * (0.7 - 0.3 * normals[:, 2])
    inverse_depth = np.empty((MAP_SIZE, MAP_SIZE), dtype=np.float32)
    surface = np.empty((MAP_SIZE, MAP_SIZE), dtype=np.int32)
    everything = np.arange(len(mesh.radii), dtype=np.int32)
    center = 0.5 * (MAP_SIZE - 1)
    for source in sources:
        rasterise(
            mesh, everything, np.eye(3), source.position, (MAP_FOCAL, MAP_FOCAL, center, center), inverse_depth, surface
        )
        add_light(points, normals, *source, inverse_depth, MAP_FOCAL, light)
    return light
