# SPDX-License-Identifier: BSD-3-Clause
"""Images whose geometry and brightness are known exactly: a textured surface seen by a pinhole camera."""

from dataclasses import dataclass, field
from typing import Tuple

import numpy as np

from ceiling_dso_ros.dso.adjustment.linearization import Linearization
from ceiling_dso_ros.dso.config import OdometryConfig, WindowConfig
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.dso.images.pyramid import PyramidPool
from ceiling_dso_ros.dso.images.selection import SelectedPixels
from ceiling_dso_ros.dso.window.candidates import CandidateTable
from ceiling_dso_ros.dso.window.keyframe_window import KeyframeWindow

CAMERA = PinholeCamera(200.0, 205.0, 160.0, 118.0, 320, 240)
SMALL_CAMERA = PinholeCamera(100.0, 102.5, 79.5, 58.5, 160, 120)
NEWTON_STEPS = 8


@dataclass(frozen=True)
class Texture:
    """Plane waves on the surface: no wavelength below `shortest`, standard deviation `contrast` grey levels."""

    seed: int = 1
    waves: int = 16
    shortest: float = 0.15  # units of length: 30 pixels at unit depth
    contrast: float = 30.0

    def __call__(self, x, y):
        rng = np.random.default_rng(self.seed)
        direction = rng.uniform(0, 2 * np.pi, self.waves)
        frequency = 2 * np.pi / (self.shortest * 4.0 ** rng.uniform(0, 1, self.waves))
        phase = rng.uniform(0, 2 * np.pi, self.waves)
        total = np.zeros(np.shape(x))
        for f, d, p in zip(frequency, direction, phase):
            total += np.cos(f * np.cos(d) * x + f * np.sin(d) * y + p)
        return 120.0 + self.contrast * np.sqrt(2.0 / self.waves) * total


SHARP = Texture(shortest=0.05, contrast=40.0, waves=24)  # rich enough for pixel selection


@dataclass(frozen=True)
class Surface:
    """z = 1 + slope . (x, y) + relief sin(4 x + 1) sin(5 y + 2) in the world, textured by its x and y."""

    slope: Tuple[float, float] = (0.0, 0.0)
    relief: float = 0.0
    texture: Texture = field(default_factory=Texture)

    def _height(self, x, y):
        sx, cx, sy, cy = np.sin(4 * x + 1), np.cos(4 * x + 1), np.sin(5 * y + 2), np.cos(5 * y + 2)
        z = 1.0 + self.slope[0] * x + self.slope[1] * y + self.relief * sx * sy
        return z, self.slope[0] + 4 * self.relief * cx * sy, self.slope[1] + 5 * self.relief * sx * cy

    def look(self, T_camera_world, parameters, u, v):
        """Grey value and inverse depth, float64, at pixels of a camera with parameters (fx, fy, cx, cy)."""
        fx, fy, cx, cy = parameters
        T_world_camera = np.linalg.inv(T_camera_world)
        rays = np.stack([(u - cx) / fx, (v - cy) / fy, np.ones(np.shape(u))], axis=-1) @ T_world_camera[:3, :3].T
        dx, dy, dz = rays[..., 0], rays[..., 1], rays[..., 2]
        ox, oy, oz = T_world_camera[:3, 3]
        depth = (1.0 - oz) / dz
        for _ in range(NEWTON_STEPS if self.relief or any(self.slope) else 0):
            z, zx, zy = self._height(ox + depth * dx, oy + depth * dy)
            depth = depth - (oz + depth * dz - z) / (dz - zx * dx - zy * dy)
        return self.texture(ox + depth * dx, oy + depth * dy), 1.0 / depth

    def idepth(self, T_camera_world, u, v, camera=CAMERA):
        """Inverse depth at pixels."""
        return self.look(T_camera_world, camera.parameters, np.asarray(u, float), np.asarray(v, float))[1]

    def render(self, T_camera_world, camera=CAMERA, affine=(0.0, 0.0), exposure=1.0):
        """Image (height, width) float32: exposure e^a I + b."""
        u, v = np.meshgrid(np.arange(camera.width, dtype=float), np.arange(camera.height, dtype=float))
        grey, _ = self.look(T_camera_world, camera.parameters, u, v)
        return (exposure * np.exp(affine[0]) * grey + affine[1]).astype(np.float32)


def random_pixels(rng, count, camera=CAMERA, border=40):
    """Whole pixels, float32, at least `border` from the edge."""
    u = rng.integers(border, camera.width - border, count).astype(np.float32)
    v = rng.integers(border, camera.height - border, count).astype(np.float32)
    return u, v


POSES = tuple(
    se3.exp(np.array(xi))
    for xi in ([0.0] * 6, [0.05, 0.02, 0.01, 0.01, -0.02, 0.03], [0.1, -0.03, 0.02, -0.02, 0.01, 0.06])
)
AFFINES = ((0.0, 0.0), (0.05, 3.0), (-0.04, -2.0))
EXPOSURES = (1.0, 1.1, 0.9)
SLANTED = Surface(slope=(-0.2, 0.1))


def empty_window(camera=CAMERA, **window):
    """A window without keyframes."""
    config = OdometryConfig(
        window=WindowConfig(**{"max_keyframes": 4, "min_keyframes": 3, "active_points": 400, **window})
    )
    return KeyframeWindow(camera, config, PyramidPool(camera, config.window.max_keyframes + 3))


def add_keyframe(window, T_camera_world, surface=SLANTED, affine=(0.0, 0.0), exposure=1.0, camera=CAMERA):
    """Add what the camera sees from a pose as a keyframe; exposure multiplies the brightness as it should."""
    slot = window.pool.build(surface.render(T_camera_world, camera, affine, exposure))
    number = window.ids[-1] + 1 if window.ids else 0
    window.add_keyframe(number, 100_000_000 * number, slot, T_camera_world, np.array(affine), exposure)


def add_points(window, host, u, v, idepth, targets=None):
    """Add points of a host with residuals into `targets`, by default all others."""
    n = u.size
    table = CandidateTable(n)
    table.add(SelectedPixels(u, v, np.ones(n, np.float32)), 0, window.image(host), window.width)
    live = np.zeros((window.keyframes.offset.shape[0], n), np.uint8)
    live[[t for t in (range(window.count) if targets is None else targets) if t != host]] = 1
    window.points.append(
        u, v, np.ones(n, np.float32), table.arrays.grey, table.arrays.weight, idepth.astype(np.float32),
        np.full(n, host), live,
    )  # fmt: skip


def true_window(
    points_per_host=60, surface=SLANTED, poses=POSES, affines=AFFINES, exposures=EXPOSURES, seed=0, **window
):
    """A window at the truth: poses, brightness and inverse depths are those the images were made with."""
    rng = np.random.default_rng(0)
    result = empty_window(**{"max_keyframes": max(4, len(poses)), "active_points": 800, **window})
    for T, affine, exposure in zip(poses, affines, exposures):
        add_keyframe(result, T, surface, affine, exposure)
    for host, T in enumerate(poses):
        u, v = random_pixels(rng, points_per_host)
        add_points(result, host, u, v, surface.idepth(T, u, v))
    return result


RELIEF = Surface(slope=(-0.2, 0.1), relief=0.08)
HOLD_FIRST = [4e10] * 3 + [1e11] * 3 + [1e12, 1e8]


def linearized(window):
    """All residuals of a window, linearised at its estimate."""
    result = Linearization(window.keyframes.offset.shape[0], window.points.capacity)
    result.update(window, window.points)
    return result


def hold_first_keyframe(window, intrinsics=1e8):
    """A prior as the first keyframe of a segment has it."""
    window.prior.H[np.arange(4), np.arange(4)] = intrinsics
    window.prior.H[np.arange(4, 12), np.arange(4, 12)] = HOLD_FIRST
