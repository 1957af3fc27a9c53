# SPDX-License-Identifier: BSD-3-Clause
"""Kernels of the lighting: how much light points of the hall get from small sources below them, with shadows."""

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel


@kernel
def add_light(
    points: np.ndarray,
    normals: np.ndarray,
    source: np.ndarray,
    power: float,
    floor: bool,
    shadow_map: np.ndarray,
    focal: float,
    irradiance: np.ndarray,
) -> None:
    """Add the light of one source to `irradiance`.

    Args:
        points: (N, 3) float64, metres.
        normals: (N, 3) float64 unit vectors.
        source: (3,) position of the source; it shines upward.
        power: irradiance at one metre above it.
        floor: the source is a patch of floor, whose light falls with the cosine of the zenith angle; that of a lamp
            does not.
        shadow_map: (S, S) float32 inverse depths as `rasterise` gives them from the source looking straight up.
        focal: focal length of the shadow map in pixels.
        irradiance: (N,) float64, output.
    """
    size = shadow_map.shape[0]
    center = 0.5 * (size - 1)
    for i in range(len(points)):
        dx, dy, dz = points[i, 0] - source[0], points[i, 1] - source[1], points[i, 2] - source[2]
        nx, ny, nz = normals[i]
        toward = -(nx * dx + ny * dy + nz * dz)
        if dz < 0.02 or toward <= 0.0:
            continue
        distance2 = dx * dx + dy * dy + dz * dz
        received = power * toward / (distance2 * np.sqrt(distance2))
        if floor:
            received *= dz / np.sqrt(distance2)
        x, y = int(center + focal * dx / dz + 0.5), int(center + focal * dy / dz + 0.5)
        if 0 <= x < size and 0 <= y < size:
            slope = min(np.sqrt(nx * nx + ny * ny) / (abs(nz) + 1e-3), 4.0)
            margin = 0.04 + slope * dz / focal
            if shadow_map[y, x] * (dz - margin) > 1.0:
                continue
        irradiance[i] += received
