# SPDX-License-Identifier: BSD-3-Clause
"""Everything that the adjustment of a drive estimates.

Unknowns are in this order: those of the whole drive, six of each keyframe, three of each point. Of the whole drive are

    0 to 5   the lens, see `parameters`
    6 to 11  the camera's mount T_base_camera: translation and rotation, both in base_link
    12 to 14 time offset of the camera, logarithms of wheel ratio and wheel base relative to the nominal ones

A keyframe's pose T_world_base is multiplied from the right by (translation, rotation). A point has its raw pixel in the
host and its inverse depth.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.io.lens_models import LensCamera
from ceiling_dso_ros.lens.parameters import rays_of, vector_of, with_vector

LENS, MOUNT, WHEELS = slice(0, 6), slice(6, 12), slice(12, 15)
OF_DRIVE = 15
OF_CAMERA = 12  # those that images depend on
OF_KEYFRAME = 6
OF_POINT = 3


@dataclass(frozen=True)
class DriveState:
    """The estimate.

    Attributes:
        lens: the raw camera.
        T_base_camera: (4, 4) float64 mount.
        wheels: (3,) float64 time offset in seconds, logarithms of ratio and base relative to nominal.
        T_world_base: (K, 4, 4) float64 poses of the base at the keyframes, metres; each segment has its own world.
        pixel: (P, 2) float64 raw pixel of each point in its host.
        ray: (P, 2) float64 its viewing ray there.
        idepth: (P,) float64 inverse depth there, 1 / m.
    """

    lens: LensCamera
    T_base_camera: np.ndarray
    wheels: np.ndarray
    T_world_base: np.ndarray
    pixel: np.ndarray
    ray: np.ndarray
    idepth: np.ndarray

    def moved(self, of_drive: np.ndarray, of_keyframes: np.ndarray, of_points: np.ndarray) -> "DriveState":
        """The state after steps of (15,), (K, 6) and (P, 3).

        Raises:
            ValueError: the step leads to no lens.
        """
        lens = with_vector(self.lens, vector_of(self.lens) + of_drive[LENS])
        if not np.isfinite(of_drive).all():
            raise ValueError("the step is not finite")
        mount = self.T_base_camera.copy()
        mount[:3, 3] += of_drive[MOUNT][:3]
        mount[:3, :3] = Rotation.from_rotvec(of_drive[MOUNT][3:]).as_matrix() @ mount[:3, :3]
        poses = self.T_world_base.copy()
        poses[:, :3, 3] += np.einsum("nij,nj->ni", poses[:, :3, :3], of_keyframes[:, :3])
        poses[:, :3, :3] = poses[:, :3, :3] @ Rotation.from_rotvec(of_keyframes[:, 3:]).as_matrix()
        pixel = self.pixel + of_points[:, :2]
        return replace(
            self,
            lens=lens,
            T_base_camera=mount,
            wheels=self.wheels + of_drive[WHEELS],
            T_world_base=poses,
            pixel=pixel,
            ray=rays_of(lens, pixel, self.ray),
            idepth=self.idepth + of_points[:, 2],
        )
