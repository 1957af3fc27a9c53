"""Kernels of the renderer: flat polygons seen by a pinhole camera, exact at every pixel centre.

For the plane n.X = d and a pixel p = (x, y, 1) with the viewing ray R K^-1 p from the centre C, the inverse depth is
w = n.(R K^-1 p) / (d - n.C), which is affine in the pixel, and so are the products of texture axes and ray. Hence a
polygon costs a multiplication per pixel to find what is nearest, and a division for its texture coordinates.

Everywhere R (3, 3) holds the axes of the camera in the world and C (3,) its centre, so T_world_camera = [R C].
"""

from typing import NamedTuple

import numpy as np

from ceiling_dso_ros.dso.jit import kernel, kernel_noalias

f32 = np.float32
NOTHING = -1
BEHIND = 1e-3  # metres in front of the camera from which a vertex counts as visible


class Mesh(NamedTuple):
    """Polygons as arrays: P polygons, V vertices in all; world coordinates in metres.

    Attributes:
        vertices: (V, 3) float64, one polygon after the other, counter-clockwise seen from the front.
        first: (P + 1,) int32, where each polygon's vertices begin.
        normals, offsets: (P, 3) and (P,) float64, the planes n.X = d.
        centers, radii: (P, 3) and (P,) float64, bounding spheres.
    """

    vertices: np.ndarray
    first: np.ndarray
    normals: np.ndarray
    offsets: np.ndarray
    centers: np.ndarray
    radii: np.ndarray


class Textures(NamedTuple):
    """What is painted on the polygons.

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
def visible_polygons(mesh, R, C, intrinsics, width, height, margin):
    """Indices of the polygons that may be seen from (R, C) moved by up to `margin` metres, (n,) int32."""
    fx, fy, cx, cy = intrinsics
    found = np.empty(len(mesh.radii), np.int32)
    count = 0
    for p in range(len(mesh.radii)):
        n, c, reach = mesh.normals[p], mesh.centers[p], mesh.radii[p] + margin
        if n[0] * C[0] + n[1] * C[1] + n[2] * C[2] < mesh.offsets[p] - margin:
            continue
        dx, dy, dz = c[0] - C[0], c[1] - C[1], c[2] - C[2]
        x = R[0, 0] * dx + R[1, 0] * dy + R[2, 0] * dz
        y = R[0, 1] * dx + R[1, 1] * dy + R[2, 1] * dz
        z = R[0, 2] * dx + R[1, 2] * dy + R[2, 2] * dz
        if (
            z > -reach
            and _beside(x, z, fx, cx + 1.0) < reach
            and _beside(-x, z, fx, width - cx) < reach
            and _beside(y, z, fy, cy + 1.0) < reach
            and _beside(-y, z, fy, height - cy) < reach
        ):
            found[count] = p
            count += 1
    return found[:count]


@kernel
def _beside(x, z, focal, edge):
    """Distance of a point outside the frustum's side plane focal * x = -edge * z; negative inside."""
    return -(focal * x + edge * z) / np.sqrt(focal * focal + edge * edge)


@kernel
def rasterise(mesh, polygons, R, C, intrinsics, inverse_depth, surface):
    """Find the nearest of the polygons at every pixel centre.

    Args:
        mesh: Mesh.
        polygons: (n,) int32 indices.
        R: (3, 3) float64.
        C: (3,) float64.
        intrinsics: fx, fy, cx, cy in pixels.
        inverse_depth: (H, W) float32, output: 1/z in 1/m along the optical axis, 0 where there is nothing.
        surface: (H, W) int32, output: index of the polygon, NOTHING where there is none.
    """
    inverse_depth[:] = f32(0)
    surface[:] = NOTHING
    height, width = surface.shape
    longest = np.max(mesh.first[1:] - mesh.first[:-1])
    corners, sides = np.empty((longest, 3)), np.empty((longest, 3))
    for p in polygons:
        wx, wy, w1, facing = inverse_depth_plane(mesh.normals[p], mesh.offsets[p], R, C, intrinsics)
        if not facing:
            continue
        count = mesh.first[p + 1] - mesh.first[p]
        top, bottom = _project(mesh.vertices[mesh.first[p] : mesh.first[p + 1]], R, C, intrinsics, height, corners)
        _side_lines(corners, count, sides)
        for y in range(top, bottom):
            start, end = _span(sides, count, y, width)
            if start < end:
                _fill(inverse_depth[y, start:end], surface[y, start:end], f32(w1 + wy * y), f32(wx), start, p)


@kernel
def inverse_depth_plane(n, d, R, C, intrinsics):
    """Coefficients of 1/z = wx x + wy y + w1 on the plane n.X = d, and whether its front faces the camera."""
    distance = d - (n[0] * C[0] + n[1] * C[1] + n[2] * C[2])
    if distance > -1e-9:
        return 0.0, 0.0, 0.0, False
    wx, wy, w1 = _ray_product(n, R, intrinsics)
    return wx / distance, wy / distance, w1 / distance, True


@kernel
def _ray_product(a, R, intrinsics):
    """Coefficients (x, y, 1) of the product of a world vector and a pixel's viewing ray R K^-1 p."""
    fx, fy, cx, cy = intrinsics
    ax = (R[0, 0] * a[0] + R[1, 0] * a[1] + R[2, 0] * a[2]) / fx
    ay = (R[0, 1] * a[0] + R[1, 1] * a[1] + R[2, 1] * a[2]) / fy
    az = R[0, 2] * a[0] + R[1, 2] * a[1] + R[2, 2] * a[2]
    return ax, ay, az - ax * cx - ay * cy


@kernel
def _project(vertices, R, C, intrinsics, height, corners):
    """Homogeneous pixels of the vertices into `corners`; returns the range of rows they cover."""
    fx, fy, cx, cy = intrinsics
    low, high, behind = 1e9, -1e9, False
    for i in range(len(vertices)):
        dx, dy, dz = vertices[i, 0] - C[0], vertices[i, 1] - C[1], vertices[i, 2] - C[2]
        z = R[0, 2] * dx + R[1, 2] * dy + R[2, 2] * dz
        corners[i, 0] = fx * (R[0, 0] * dx + R[1, 0] * dy + R[2, 0] * dz) + cx * z
        corners[i, 1] = fy * (R[0, 1] * dx + R[1, 1] * dy + R[2, 1] * dz) + cy * z
        corners[i, 2] = z
        if z < BEHIND:
            behind = True
        else:
            low, high = min(low, corners[i, 1] / z), max(high, corners[i, 1] / z)
    if behind:
        return 0, height
    return int(np.ceil(min(max(low, 0.0), float(height)))), int(np.ceil(min(max(high, 0.0), float(height))))


@kernel
def _side_lines(corners, count, sides):
    """Lines e.(x, y, 1) >= 0 inside: e = q_i+1 x q_i of homogeneous pixels, also for vertices behind the camera."""
    for i in range(count):
        a, b = corners[i], corners[(i + 1) % count]
        sides[i, 0] = a[2] * b[1] - a[1] * b[2]
        sides[i, 1] = a[0] * b[2] - a[2] * b[0]
        sides[i, 2] = a[1] * b[0] - a[0] * b[1]


@kernel
def _span(sides, count, y, width):
    """Pixels [start, end) of row y whose centres lie inside; neighbours with a common side leave no gap."""
    low, high = 0.0, float(width)
    for i in range(count):
        a, rest = sides[i, 0], sides[i, 1] * y + sides[i, 2]
        if a > 0.0:
            low = max(low, -rest / a)
        elif a < 0.0:
            high = min(high, -rest / a)
        elif rest < 0.0:
            return 0, 0
    if not low < high:
        return 0, 0
    return int(np.ceil(low)), int(np.ceil(high))


@kernel_noalias
def _fill(inverse_depth, surface, w, wx, start, p):
    for i in range(surface.size):
        here = w + wx * f32(start + i)
        nearer = here > inverse_depth[i]
        inverse_depth[i] = here if nearer else inverse_depth[i]
        surface[i] = p if nearer else surface[i]


@kernel
def expose(scene, polygons, R, C, intrinsics, inverse_depth, surface, radiance):
    """Mean of several sharp pictures, each with its own pose and principal point.

    All are shaded row by row together, because they read nearly the same texels.

    Args:
        scene: (Mesh, Textures).
        polygons: (n,) int32, those that may be seen.
        R: (K, 3, 3) float64.
        C: (K, 3) float64.
        intrinsics: (K, 4) fx fy cx cy.
        inverse_depth: (H, W) float32, for use inside.
        surface: (K, H, W) int32, for use inside.
        radiance: (H, W) float32, output, in units of the texels.
    """
    mesh, textures = scene
    views = np.empty((len(R), len(mesh.radii), 11), np.float32)
    for k in range(len(R)):
        fx, fy, cx, cy = intrinsics[k]
        rasterise(mesh, polygons, R[k], C[k], (fx, fy, cx, cy), inverse_depth, surface[k])
        for p in polygons:
            _texture_view(mesh, textures, p, R[k], C[k], (fx, fy, cx, cy), views[k, p])
    radiance[:] = f32(0)
    for y in range(surface.shape[1]):
        for k in range(len(R)):
            _shade_row(textures, views[k], surface[k, y], y, radiance[y])
        radiance[y] /= f32(len(R))


@kernel
def _shade_row(textures, views, surface, y, radiance):
    start, width = 0, surface.size
    while start < width:
        p, end = surface[start], start + 1
        while end < width and surface[end] == p:
            end += 1
        if p != NOTHING:
            rows, columns = textures.shapes[p]
            first = textures.starts[p]
            texels = textures.texels[first : first + rows * columns]
            _sample(texels, rows, columns, views[p], y, start, radiance[start:end])
        start = end


@kernel
def _texture_view(mesh, textures, p, R, C, intrinsics, view):
    """Texture coordinates seen in the image: u = u_C + (u_x x + u_y y + u_1) / w with w the inverse depth, same for v.

    view holds w_x w_y w_1, u_x u_y u_1, v_x v_y v_1, u_C v_C.
    """
    view[0], view[1], view[2], _ = inverse_depth_plane(mesh.normals[p], mesh.offsets[p], R, C, intrinsics)
    for k in range(2):
        axis = textures.axes[p, k]
        view[3 + 3 * k], view[4 + 3 * k], view[5 + 3 * k] = _ray_product(axis, R, intrinsics)
        offset = 0.0
        for i in range(3):
            offset += axis[i] * (C[i] - textures.origins[p, i])
        view[9 + k] = offset


@kernel_noalias
def _sample(texels, rows, columns, view, y, start, radiance):
    """Bilinear texture along a piece of an image row."""
    w, w_x = view[2] + view[1] * f32(y), view[0]
    u, u_x = view[5] + view[4] * f32(y), view[3]
    v, v_x = view[8] + view[7] * f32(y), view[6]
    u_C, v_C = view[9], view[10]
    u_end, v_end = f32(columns) - f32(1.001), f32(rows) - f32(1.001)
    for i in range(radiance.size):
        x = f32(start + i)
        depth = f32(1) / (w + w_x * x)
        a = min(max(u_C + (u + u_x * x) * depth, f32(0)), u_end)
        b = min(max(v_C + (v + v_x * x) * depth, f32(0)), v_end)
        column, row = np.int32(a), np.int32(b)
        fu, fv = a - f32(column), b - f32(row)
        k = row * columns + column
        upper = f32(texels[k]) + fu * (f32(texels[k + 1]) - f32(texels[k]))
        k += columns
        lower = f32(texels[k]) + fu * (f32(texels[k + 1]) - f32(texels[k]))
        radiance[i] += upper + fv * (lower - upper)
