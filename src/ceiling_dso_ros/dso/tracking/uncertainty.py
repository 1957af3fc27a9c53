# SPDX-License-Identifier: BSD-3-Clause
"""Uncertainty of a tracked pose: which motions of the camera the image determines.

J^T W J of the tracking treats every image gradient as texture, also gradients of pure noise. With M the same sum for
gradients of one grey level per pixel in either direction, the generalised eigenvalues of (J^T W J, M) are mean squared
gradients along independent motions of the camera. The contribution of noise is subtracted from each (errors in
variables). Then a motion along the only visible edge has hardly any information left.
"""

from dataclasses import dataclass

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.geometry.projection import intrinsics_of, pose_jacobian, unproject, warp_of, warp_point

# Neighbouring points share depth errors, and the pose of the keyframe has an error of its own, so that residuals count
# for far less than as many independent ones. Measured: simulated drives on three ceilings, 848x480.
CORRELATION = 9.0
# The first map comes from two views from nearby positions. Until more distant views have corrected it, its error is
# larger than that of the tracking. Measured in the same way: its variance relative to that of the tracking, and the
# number of keyframes in which it falls to 1 / e.
FIRST_MAP, FIRST_MAP_KEYFRAMES = 20.0, 4.0
# Variance of a central difference of independent noise is half of the noise's, of its bilinear interpolation 4/9 of
# that, and the noise's at most half of the squared photometric error between two images.
GRADIENT_NOISE = 0.11
MAX_NOISE_RMSE = 4.0  # grey levels; a larger error is not noise but blur or a wrong model
MIN_SHARE = 0.05  # of the noise's squared gradient that remains as information, so that the covariance is finite


def noise_gradient2(rmse: float) -> float:
    """Squared gradient that noise alone gives, from the photometric error in grey levels."""
    return GRADIENT_NOISE * min(rmse, MAX_NOISE_RMSE) ** 2


@kernel
def unit_information(
    u: np.ndarray, v: np.ndarray, idepth: np.ndarray, intrinsics: np.ndarray, T_frame_reference: np.ndarray
) -> np.ndarray:
    """Sum of K^T K over points, (6, 6) float64, with K the derivative of a pixel by (translation, rotation).

    Args:
        u, v, idepth: (n,) float32 points of the reference.
        intrinsics: (4,) float64.
        T_frame_reference: (4, 4) float64, the motion; its left increment is what K refers to.
    """
    camera = intrinsics_of(intrinsics)
    motion = warp_of(T_frame_reference[:3, :3], T_frame_reference[:3, 3])
    total = np.zeros((6, 6))
    K = np.empty((2, 6))
    for i in range(u.size):
        x_reference, y_reference = unproject(camera, u[i], v[i])
        x, y, z, z_inverse = warp_point(motion, x_reference, y_reference, idepth[i])
        if z <= 0.0:
            continue
        of_u, of_v = pose_jacobian(camera, x, y, idepth[i] * z_inverse)
        K[0, 0], K[0, 1], K[0, 2], K[0, 3], K[0, 4], K[0, 5] = of_u
        K[1, 0], K[1, 1], K[1, 2], K[1, 3], K[1, 4], K[1, 5] = of_v
        for a in range(6):
            for b in range(6):
                total[a, b] += K[0, a] * K[0, b] + K[1, a] * K[1, b]
    return total


@dataclass(frozen=True)
class Observability:
    """How well the image determines each motion of the camera.

    Attributes:
        gradients: (6,) float64 mean squared gradient along each motion, growing, (grey levels / pixel)^2.
        motions: (6, 6) float64, in columns, (translation, rotation) as left increments on T_frame_reference, such
            that one moves the points by one pixel, root of the sum of squares.
        noise: squared gradient that noise alone gives.
    """

    gradients: np.ndarray
    motions: np.ndarray
    noise: float

    @classmethod
    def of(cls, information: np.ndarray, unit: np.ndarray, rmse: float) -> "Observability":
        """Split J^T W J, (6, 6), by the `unit_information` of as many points; rmse of the tracking in grey levels."""
        scale = 1.0 / np.sqrt(np.diag(unit) + 1e-12 * np.trace(unit))
        lower = np.linalg.cholesky(scale[:, None] * unit * scale + 1e-9 * np.eye(6))
        half = np.linalg.solve(lower, scale[:, None] * information * scale)
        gradients, vectors = np.linalg.eigh(np.linalg.solve(lower, half.T))
        motions = scale[:, None] * np.linalg.solve(lower.T, vectors)
        return cls(gradients, motions, noise_gradient2(rmse))

    @property
    def weakest(self) -> float:
        """Squared gradient along the motion that the image determines worst, relative to that of noise."""
        return float(self.gradients[0] / self.noise) if self.noise > 0 else np.inf

    def covariance(self, rmse: float) -> np.ndarray:
        """Covariance (6, 6) float64 of (translation, rotation), a left increment on T_frame_reference."""
        known = np.maximum(self.gradients - self.noise, MIN_SHARE * self.noise + 1e-9)
        return CORRELATION * rmse**2 * (self.motions / known) @ self.motions.T


def map_error(age: int) -> float:
    """Factor by which the map's error enlarges the covariance of poses, `age` keyframes after the first map's."""
    return 1.0 + FIRST_MAP * float(np.exp(-age / FIRST_MAP_KEYFRAMES))


def world_covariance(covariance: np.ndarray, T_camera_world: np.ndarray) -> np.ndarray:
    """Covariance of a left increment on T_camera_world as that of one on T_world_camera, both (6, 6) float64."""
    adjoint = se3.adjoint(se3.inverse(T_camera_world))
    return adjoint @ covariance @ adjoint.T
