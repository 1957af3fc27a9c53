# SPDX-License-Identifier: BSD-3-Clause
"""Renders images of a scene, integrated over the exposure time and over the area of each pixel, and their depth."""

import cv2
import numpy as np

from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.simulation.rendering.raster_kernels import rasterise, visible_polygons
from ceiling_dso_ros.simulation.rendering.scene import TEXEL_LEVELS, Scene
from ceiling_dso_ros.simulation.rendering.shading_kernels import expose

# Edges are sampled at 16 points: x and y within the pixel and time within the exposure. Each column contains every 16th
# once, and the columns are uncorrelated with mean zero (an orthogonal Latin hypercube). So edges are smooth, and moving
# edges are blurred.
_HALF = [
    (1, 5, 3), (3, 13, -7), (5, -1, 11), (7, -9, -15), (9, 15, 5), (11, 7, -1), (13, -11, 13), (15, -3, -9),
]  # fmt: skip
SAMPLES = np.array(_HALF + [(-x, -y, -t) for x, y, t in _HALF]) / 32.0
# Smooth textures need four samples: two-point Gauss quadrature in each column, again uncorrelated.
TEXTURE_SAMPLES = np.array([(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)]) / (2.0 * np.sqrt(3.0))
SAMPLE_TIMES = np.concatenate([SAMPLES, TEXTURE_SAMPLES])[:, 2]  # in exposures from the middle
LENS_BLUR_PX = 0.45
MOTION_M = 0.1  # how far the camera may move within one exposure


class Renderer:
    """Renders one scene for one camera; may be used from several threads at once.

    Args:
        scene: geometry and textures.
        camera: intrinsics without distortion.
    """

    def __init__(self, scene: Scene, camera: PinholeCamera) -> None:
        self.scene = scene
        self.camera = camera

    def expose(self, T_world_camera: np.ndarray) -> np.ndarray:
        """Radiance that the camera receives during an exposure.

        Args:
            T_world_camera: (20, 4, 4) poses at SAMPLE_TIMES.

        Returns:
            (height, width) float32 where 1 saturates the sensor at the reference exposure.
        """
        shape = (self.camera.height, self.camera.width)
        intrinsics = np.tile(self.camera.parameters, (len(SAMPLE_TIMES), 1))
        intrinsics[:, 2:] -= np.concatenate([SAMPLES, TEXTURE_SAMPLES])[:, :2]
        radiance = np.empty(shape, dtype=np.float32)
        expose(
            self.scene,
            self._visible(T_world_camera[0]),
            np.ascontiguousarray(T_world_camera[:, :3, :3]),
            np.ascontiguousarray(T_world_camera[:, :3, 3]),
            intrinsics,
            np.empty(shape, dtype=np.float32),
            np.empty((len(SAMPLES), *shape), dtype=np.int32),
            radiance,
        )
        blurred: np.ndarray = cv2.GaussianBlur(radiance, (0, 0), LENS_BLUR_PX)
        return blurred / np.float32(TEXEL_LEVELS)

    def inverse_depth(self, T_world_camera: np.ndarray) -> np.ndarray:
        """1/z at every pixel centre, (height, width) float32 in 1/m along the optical axis, of a pose (4, 4)."""
        shape = (self.camera.height, self.camera.width)
        inverse_depth = np.empty(shape, dtype=np.float32)
        R, C = np.ascontiguousarray(T_world_camera[:3, :3]), np.ascontiguousarray(T_world_camera[:3, 3])
        surface = np.empty(shape, dtype=np.int32)
        rasterise(
            self.scene.mesh, self._visible(T_world_camera), R, C, tuple(self.camera.parameters), inverse_depth, surface
        )
        return inverse_depth

    def _visible(self, T_world_camera: np.ndarray) -> np.ndarray:
        camera = self.camera
        R, C = np.ascontiguousarray(T_world_camera[:3, :3]), np.ascontiguousarray(T_world_camera[:3, 3])
        return visible_polygons(self.scene.mesh, R, C, tuple(camera.parameters), camera.width, camera.height, MOTION_M)
