# SPDX-License-Identifier: BSD-3-Clause
"""Turns the description of a hall into arrays for rendering: geometry, and textures that include the light.

A robot on a flat floor sees every part of a ceiling from the same height. So one texel size per surface (half of what a
pixel covers there) and one low-pass filter are right for all images: a point has the same grey value in all of them.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any, Dict, List, NamedTuple, Sequence, Tuple

import cv2
import numpy as np

from ceiling_dso_ros.simulation.obstacles import Obstacles
from ceiling_dso_ros.simulation.rendering.geometry import Sheet, Surface
from ceiling_dso_ros.simulation.rendering.lighting import Source, floor_sources, irradiance
from ceiling_dso_ros.simulation.rendering.raster_kernels import Mesh
from ceiling_dso_ros.simulation.rendering.shading_kernels import Textures

CAMERA_HEIGHT_M = 0.62
TEXELS_PER_PIXEL = 1.6
LOW_PASS_PX = 0.7
LIGHT_GRID_M = 0.08
PAINTERS = 2  # threads
TEXEL_LEVELS = 8192  # texel value of radiance 1, which saturates the sensor at the reference exposure


@dataclass(frozen=True)
class Hall:
    """Description of a hall with its ceiling.

    Attributes:
        surfaces: everything that can be seen.
        lamps: positions and powers of the lamps that light their surroundings.
        size_m: length (x) and width (y) of the floor.
        obstacles: what stands and moves on the floor.
        description: what was drawn at random, for those who judge how difficult it is.
    """

    surfaces: Sequence[Surface]
    lamps: Sequence[Source]
    size_m: Tuple[float, float]
    obstacles: Obstacles
    description: Dict[str, Any] = field(default_factory=dict)


class Scene(NamedTuple):
    """A hall ready for rendering."""

    mesh: Mesh
    textures: Textures


def build_scene(hall: Hall, focal_px: float, seed: int) -> Scene:
    """Paint and light everything that can be seen from the floor.

    Args:
        hall: its description.
        focal_px: focal length of the camera for which the textures are made.
        seed: of all random choices.
    """
    surfaces = [surface for surface in hall.surfaces if _visible_from_floor(surface, hall.size_m)]
    mesh = build_mesh(surfaces)
    sources = [*floor_sources(hall.size_m, np.random.default_rng([seed, 1])), *hall.lamps]
    grids = [_light_grid(surface) for surface in surfaces]
    points, normals = (np.concatenate([grid[k].reshape(-1, 3) for grid in grids]) for k in (0, 1))
    light = irradiance(mesh, sources, points, normals)
    ends = np.cumsum([grid[0].shape[0] * grid[0].shape[1] for grid in grids])
    lights = [part.reshape(grid[0].shape[:2]) for part, grid in zip(np.split(light, ends[:-1]), grids)]
    return Scene(mesh, _bake(surfaces, lights, focal_px, seed))


def build_mesh(surfaces: Sequence[Surface]) -> Mesh:
    """Geometry of the surfaces as arrays."""
    normals = np.array([surface.normal for surface in surfaces])
    centers = np.array([surface.vertices.mean(axis=0) for surface in surfaces])
    return Mesh(
        vertices=np.concatenate([surface.vertices for surface in surfaces]),
        first=np.cumsum([0] + [len(surface.vertices) for surface in surfaces]).astype(np.int32),
        normals=normals,
        offsets=np.array([n @ surface.vertices[0] for n, surface in zip(normals, surfaces)]),
        centers=centers,
        radii=np.array([np.linalg.norm(s.vertices - c, axis=1).max() for c, s in zip(centers, surfaces)]),
    )


def _visible_from_floor(surface: Surface, size_m: Tuple[float, float]) -> bool:
    """Whether the front of a surface is visible from any possible position of the robot's camera."""
    places = np.array([[x * size_m[0] / 2, y * size_m[1] / 2, z] for x in (-1, 1) for y in (-1, 1) for z in (0.2, 1.5)])
    return bool(((places - surface.vertices[0]) @ surface.normal > 0).any())


def _light_grid(surface: Surface) -> Tuple[np.ndarray, np.ndarray]:
    """Points on a surface where light is computed, and their normals: (rows, columns, 3) each."""
    columns, rows = (np.linspace(0.0, side, int(np.ceil(side / LIGHT_GRID_M)) + 1) for side in surface.extent_m)
    across, along = columns[None, :, None] * surface.axis_u, rows[:, None, None] * surface.axis_v
    points = surface.origin + across + along
    if surface.edge_normals is None:
        return points, np.broadcast_to(surface.normal, points.shape)
    share = (rows / rows[-1])[:, None, None]
    normals = (1 - share) * surface.edge_normals[0] + share * surface.edge_normals[1]
    return points, np.broadcast_to(normals / np.linalg.norm(normals, axis=-1, keepdims=True), points.shape)


def _bake(surfaces: Sequence[Surface], lights: Sequence[np.ndarray], focal_px: float, seed: int) -> Textures:
    """Paint every sheet once and cut the surfaces out of it, lit."""
    sheets = [list(group) for _, group in groupby(zip(surfaces, lights), key=lambda pair: id(pair[0].sheet))]

    def paint(number: int) -> List[Tuple[np.ndarray, float]]:
        first = sheets[number][0][0]
        canvas, texel_m = _paint(first.sheet, _pixel_on(first, focal_px), (seed, 2, number))
        return [(_cut(canvas, surface, texel_m, light), texel_m) for surface, light in sheets[number]]

    with ThreadPoolExecutor(PAINTERS) as executor:
        painted = [texture for textures in executor.map(paint, range(len(sheets))) for texture in textures]
    textures, texel_m = zip(*painted)
    axes = np.array([[surface.axis_u, surface.axis_v] for surface in surfaces])
    return Textures(
        texels=np.concatenate([texture.reshape(-1) for texture in textures]),
        starts=np.cumsum([0, *(texture.size for texture in textures[:-1])]).astype(np.int64),
        shapes=np.array([texture.shape for texture in textures], dtype=np.int32),
        origins=np.array([surface.origin for surface in surfaces]),
        axes=axes / np.array(texel_m)[:, None, None],
    )


def _pixel_on(surface: Surface, focal_px: float) -> float:
    """What a pixel of the upward camera covers on a surface, metres."""
    heights = surface.vertices[:, 2]
    return (
        max((heights.mean() + heights.max()) / 2 - CAMERA_HEIGHT_M, 1.5) / focal_px * surface.sheet.material.coarseness
    )


def _paint(sheet: Sheet, pixel_m: float, seed: Tuple[int, ...]) -> Tuple[np.ndarray, float]:
    canvas = sheet.material.canvas(sheet.size_m, pixel_m / TEXELS_PER_PIXEL, seed)
    canvas.low_pass(LOW_PASS_PX * pixel_m)
    return canvas.values, canvas.texel_m


def _cut(canvas: np.ndarray, surface: Surface, texel_m: float, light: np.ndarray) -> np.ndarray:
    """The surface's own texture: its part of the sheet times its light, (rows, columns) uint16."""
    columns, rows = (int(np.ceil(side / texel_m)) + 2 for side in surface.extent_m)
    left, top = (round(offset / texel_m) for offset in surface.offset_m)
    part = canvas[top : top + rows, left : left + columns]
    part = cv2.copyMakeBorder(part, 0, rows - part.shape[0], 0, columns - part.shape[1], cv2.BORDER_REPLICATE)
    if not surface.sheet.material.luminous:
        part = part * _interpolated(light, surface.extent_m, texel_m, part.shape)
    return np.clip(part * TEXEL_LEVELS + 0.5, 0, 65535).astype(np.uint16)


def _interpolated(
    light: np.ndarray, extent_m: Tuple[float, float], texel_m: float, shape: Tuple[int, int]
) -> np.ndarray:
    """Light at every texel, interpolated bilinearly from the nodes."""
    across, along = ((nodes - 1) * texel_m / extent for nodes, extent in zip(light.shape[::-1], extent_m))
    nodes_of_texels = np.array([[across, 0.0, 0.0], [0.0, along, 0.0]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return cv2.warpAffine(
        light.astype(np.float32), nodes_of_texels, shape[::-1], flags=flags, borderMode=cv2.BORDER_REPLICATE
    )
