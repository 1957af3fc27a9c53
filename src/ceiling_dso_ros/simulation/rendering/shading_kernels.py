# SPDX-License-Identifier: BSD-3-Clause
"""Kernels that shade pixels: textures, integrated over the area of the pixel and the exposure time.

The inverse depth w of a polygon is affine in the pixel, so its texture coordinates are (affine) / w: one division.
"""

from typing import NamedTuple, Tuple

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel, kernel_noalias
from ceiling_dso_ros.simulation.rendering.raster_kernels import (
    NOTHING,
    Intrinsics,
    Mesh,
    inverse_depth_plane,
    rasterise,
    ray_product,
)

f32 = np.float32


class Textures(NamedTuple):
    """Textures of the polygons.

    Attributes:
        texels: (T,) uint16, all textures one after the other, row by row.
        starts: (P,) int64, each polygon's first texel.
        shapes: (P, 2) int32 rows, columns.
        origins: (P, 3) float64, the world point of texel (0, 0).
        axes: (P, 2, 3) float64, texels per metre along u and v.
    """

    texels: np.ndarray
    starts: np.ndarray
    shapes: np.ndarray
    origins: np.ndarray
    axes: np.ndarray


@kernel
def expose(
    scene: Tuple[Mesh, Textures],
    polygons: np.ndarray,
    R: np.ndarray,
    C: np.ndarray,
    intrinsics: np.ndarray,
    inverse_depth: np.ndarray,
    surface: np.ndarray,
    radiance: np.ndarray,
) -> None:
    """Image integrated over the area of each pixel and the exposure time.

    The visible polygon is found for K samples. A pixel with the same polygon in all of them is shaded with the L
    further samples, which may be few because textures are smooth. Other pixels are the mean of the K samples.

    Args:
        scene: (Mesh, Textures).
        polygons: (n,) int32, those that may be seen.
        R: (K + L, 3, 3) float64.
        C: (K + L, 3) float64.
        intrinsics: (K + L, 4) fx fy cx cy.
        inverse_depth: (H, W) float32, scratch memory.
        surface: (K, H, W) int32, scratch memory.
        radiance: (H, W) float32, output, in units of the texels.
    """
    mesh, textures = scene
    samples, height, width = surface.shape
    views = np.empty((len(R), len(mesh.radii), 11), np.float32)
    for k in range(len(R)):
        fx, fy, cx, cy = intrinsics[k]
        if k < samples:
            rasterise(mesh, polygons, R[k], C[k], (fx, fy, cx, cy), inverse_depth, surface[k])
        for p in polygons:
            _texture_view(mesh, textures, p, R[k], C[k], (fx, fy, cx, cy), views[k, p])
    same = np.empty(width, np.bool_)
    for y in range(height):
        same[:] = True
        for k in range(1, samples):
            _compare(surface[0, y], surface[k, y], same)
        _shade_row(textures, views, surface[:, y], y, same, radiance[y])


@kernel_noalias
def _compare(one: np.ndarray, other: np.ndarray, same: np.ndarray) -> None:
    for x in range(same.size):
        same[x] &= one[x] == other[x]


@kernel
def _shade_row(
    textures: Textures, views: np.ndarray, surface: np.ndarray, y: int, same: np.ndarray, radiance: np.ndarray
) -> None:
    radiance[:] = f32(0)
    samples, width = surface.shape
    start = 0
    while start < width:
        p, end = surface[0, start], start + 1
        if not same[start]:
            radiance[start] = _mean_of_samples(textures, views, surface[:, start], y, start)
        else:
            while end < width and same[end] and surface[0, end] == p:
                end += 1
            if p != NOTHING:
                texels = _texture(textures, p)
                for k in range(samples, len(views)):
                    _sample(texels, textures.shapes[p], views[k, p], y, start, radiance[start:end])
                radiance[start:end] /= f32(len(views) - samples)
        start = end


@kernel
def _mean_of_samples(textures: Textures, views: np.ndarray, surface: np.ndarray, y: int, x: int) -> np.float32:
    """One pixel at the edge of a polygon."""
    total = f32(0)
    for k in range(surface.size):
        p = surface[k]
        if p != NOTHING:
            total += _texel(_texture(textures, p), textures.shapes[p], views[k, p], y, x)
    return total / f32(surface.size)


@kernel
def _texture(textures: Textures, p: int) -> np.ndarray:
    first = textures.starts[p]
    return textures.texels[first : first + textures.shapes[p, 0] * textures.shapes[p, 1]]


@kernel
def _texture_view(
    mesh: Mesh, textures: Textures, p: int, R: np.ndarray, C: np.ndarray, intrinsics: Intrinsics, view: np.ndarray
) -> None:
    """Texture coordinates of a pixel: u = u_C + (u_x x + u_y y + u_1) / w with the inverse depth w, likewise v.

    view holds w_x w_y w_1, u_x u_y u_1, v_x v_y v_1, u_C v_C.
    """
    view[0], view[1], view[2], _ = inverse_depth_plane(mesh.normals[p], mesh.offsets[p], R, C, intrinsics)
    for k in range(2):
        axis = textures.axes[p, k]
        view[3 + 3 * k], view[4 + 3 * k], view[5 + 3 * k] = ray_product(axis, R, intrinsics)
        offset = 0.0
        for i in range(3):
            offset += axis[i] * (C[i] - textures.origins[p, i])
        view[9 + k] = offset


@kernel_noalias
def _sample(texels: np.ndarray, shape: np.ndarray, view: np.ndarray, y: int, start: int, radiance: np.ndarray) -> None:
    """Add the texture along a piece of an image row."""
    for i in range(radiance.size):
        radiance[i] += _texel(texels, shape, view, y, start + i)


@kernel
def _texel(texels: np.ndarray, shape: np.ndarray, view: np.ndarray, y: int, x: int) -> np.float32:
    """Bilinear texture at one pixel."""
    row, column = f32(y), f32(x)
    depth = f32(1) / (view[0] * column + view[1] * row + view[2])
    u = view[9] + (view[3] * column + view[4] * row + view[5]) * depth
    v = view[10] + (view[6] * column + view[7] * row + view[8]) * depth
    u = min(max(u, f32(0)), f32(shape[1]) - f32(1.001))
    v = min(max(v, f32(0)), f32(shape[0]) - f32(1.001))
    i, j = np.int32(u), np.int32(v)
    fu, fv = u - f32(i), v - f32(j)
    k = j * shape[1] + i
    upper = f32(texels[k]) + fu * (f32(texels[k + 1]) - f32(texels[k]))
    k += shape[1]
    lower = f32(texels[k]) + fu * (f32(texels[k + 1]) - f32(texels[k]))
    return upper + fv * (lower - upper)
