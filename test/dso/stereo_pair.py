# SPDX-License-Identifier: BSD-3-Clause
"""Images of two cameras under surfaces whose texture is a sum of waves: exact between pixels, too."""

import numpy as np

from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.dso.geometry.projection import viewing_rays
from ceiling_dso_ros.dso.stereo.rig import StereoRig

CAMERA = PinholeCamera(210.0, 210.0, 159.2, 119.7, 320, 240)
BASELINE_M = 0.095
SHORTEST_WAVE_PX = 6.0


def side_by_side(camera=CAMERA, turn=np.zeros(3)):
    """The second camera to the right, and turned a little."""
    return StereoRig(camera, se3.exp(np.array([0.0, 0.0, 0.0, *turn])) @ _shifted(BASELINE_M))


def _shifted(x):
    T = np.eye(4)
    T[0, 3] = x
    return T


class Plane:
    """A surface n X = 1 in the left camera's frame, in metres, with waves on it."""

    def __init__(self, normal, seed=0, waves=24, contrast=14.0):
        rng = np.random.default_rng(seed)
        self.normal = np.asarray(normal, float)
        depth = 1.0 / self.normal[2]
        highest = 2 * np.pi * CAMERA.fx / depth / SHORTEST_WAVE_PX
        angle, size = rng.uniform(0, 2 * np.pi, waves), highest * rng.uniform(0.2, 1.0, waves)
        self._waves = np.column_stack([size * np.cos(angle), size * np.sin(angle), rng.uniform(0, 2 * np.pi, waves)])
        self._contrast = contrast * np.sqrt(2.0 / waves)

    def grey(self, points):
        """Grey values at (..., 3) points."""
        return 120.0 + self._contrast * sum(np.cos(fx * points[..., 0] + fy * points[..., 1] + phase)
                                            for fx, fy, phase in self._waves)  # fmt: skip

    def seen_by(self, camera, T_left_camera=np.eye(4)):
        """The image (height, width) float32 of a camera."""
        v, u = np.mgrid[: camera.height, : camera.width]
        rays = viewing_rays(camera.parameters, u, v) @ T_left_camera[:3, :3].T
        centre = T_left_camera[:3, 3]
        depth = (1.0 - self.normal @ centre) / (rays @ self.normal)
        return self.grey(centre + depth[..., None] * rays).astype(np.float32)

    def inverse_depth(self, camera, u, v):
        """1/z of left pixels."""
        return viewing_rays(camera.parameters, u, v) @ self.normal


def scattered(camera, count, rng, border=8.0):
    """Pixels (u, v) at any fractions, float32."""
    u = rng.uniform(border, camera.width - 1 - border, count).astype(np.float32)
    return u, rng.uniform(border, camera.height - 1 - border, count).astype(np.float32)
