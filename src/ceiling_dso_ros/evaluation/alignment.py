# SPDX-License-Identifier: BSD-3-Clause
"""Aligns an estimated trajectory with its reference: equations (14) and (15).

The closed form is S. Umeyama, "Least-squares estimation of transformation parameters between two point patterns",
PAMI 1991, in three dimensions or, for motion in the plane, in x and y.
"""

import enum
from dataclasses import dataclass

import numpy as np

MIN_PAIRS = 3

# The rotation is not determined if the points' spread across their main line is less than this part of that along it.
_COLLINEAR_RATIO = 1e-3


class AlignmentError(ValueError):
    """The pairs do not determine the transformation; the message says why."""


class AlignmentKind(enum.Enum):
    """Which transformation the estimate may be moved by."""

    SIM3 = "sim3"  # rotation, translation, scale: a monocular camera
    SE3 = "se3"  # rotation, translation: metric in space
    SE2 = "se2"  # yaw and a shift in x, y: metric in the plane
    SIM2 = "sim2"  # SE2 with scale

    @property
    def scaled(self) -> bool:
        """True when the scale is estimated, too."""
        return self in (AlignmentKind.SIM3, AlignmentKind.SIM2)

    @property
    def planar(self) -> bool:
        """True when only x, y and yaw count."""
        return self in (AlignmentKind.SE2, AlignmentKind.SIM2)


@dataclass(frozen=True)
class Alignment:
    """S = (R, t, lambda) that maps the estimate's world to the reference's.

    Attributes:
        kind: what was estimated.
        R: (3, 3) float64 rotation; about z alone when planar.
        t_m: (3,) float64 in the reference's unit; no z when planar.
        scale: lambda, reference units per unit of the estimate.
        rotation_determined: False when the points lie on one line, so a rotation about this line changes no
            position error, and the rotation (hence every orientation error) is arbitrary.
    """

    kind: AlignmentKind
    R: np.ndarray
    t_m: np.ndarray
    scale: float
    rotation_determined: bool = True

    def apply(self, poses: np.ndarray) -> np.ndarray:
        """Equation (15) on poses (N, 4, 4); returns poses in the reference's world, (N, 4, 4)."""
        aligned = poses.copy()
        aligned[:, :3, :3] = self.R @ poses[:, :3, :3]
        aligned[:, :3, 3] = self.scale * poses[:, :3, 3] @ self.R.T + self.t_m
        return aligned


def align(estimate: np.ndarray, reference: np.ndarray, kind: AlignmentKind) -> Alignment:
    """Least-squares transformation of positions, equation (14).

    Args:
        estimate: (N, 3) float64 positions p_i.
        reference: (N, 3) float64 positions g_i of the same instants.
        kind: which transformation.

    Raises:
        AlignmentError: fewer than three pairs, or, where the scale is wanted, one side does not move.
    """
    if len(estimate) < MIN_PAIRS:
        raise AlignmentError(f"{len(estimate)} pairs of poses, at least {MIN_PAIRS} are needed to align")
    dimensions = 2 if kind.planar else 3
    p, g = estimate[:, :dimensions], reference[:, :dimensions]
    p_mean, g_mean = p.mean(axis=0), g.mean(axis=0)
    p_centred, g_centred = p - p_mean, g - g_mean
    for name, points in (("estimate", p), ("reference", g)):
        if kind.scaled and np.ptp(points, axis=0).max() == 0.0:
            raise AlignmentError(f"the {name} does not move, so its scale cannot be estimated")

    U, singular, Vt = np.linalg.svd(g_centred.T @ p_centred / len(p))
    signs = np.ones(dimensions)
    signs[-1] = np.sign(np.linalg.det(U) * np.linalg.det(Vt))  # a rotation, not a reflection
    R = np.eye(3)
    R[:dimensions, :dimensions] = (U * signs) @ Vt
    scale = float(singular @ signs / np.mean(np.sum(p_centred**2, axis=1))) if kind.scaled else 1.0
    t_m = np.zeros(3)
    t_m[:dimensions] = g_mean - scale * R[:dimensions, :dimensions] @ p_mean
    spread = np.sqrt(singular)
    determined = bool(spread[dimensions - 2] > _COLLINEAR_RATIO * spread[0])
    return Alignment(kind, R, t_m, scale, determined)
