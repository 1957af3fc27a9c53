# SPDX-License-Identifier: BSD-3-Clause
"""Initialisation: pose and depth from two frames with parallax; the only assumption is that depth is smooth."""

import copy
from dataclasses import dataclass
from typing import List, Optional, Tuple

import numpy as np

from ceiling_dso_ros.dso.adjustment.linearization import scratch_memory
from ceiling_dso_ros.dso.compute.linear_solver import solve_positive
from ceiling_dso_ros.dso.config import InitializationConfig
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.geometry.camera_motion import CameraMotion
from ceiling_dso_ros.dso.geometry.projection import level_intrinsics, viewing_rays
from ceiling_dso_ros.dso.images.gradient_cells import TEXTURE_LEVEL, strongest_per_cell, textured_share
from ceiling_dso_ros.dso.images.pyramid import PyramidPool
from ceiling_dso_ros.dso.images.selection import PixelSelector, SelectedPixels, squared_gradient
from ceiling_dso_ros.dso.mapping.first_map import FirstMap
from ceiling_dso_ros.dso.start.initialization_kernels import align_level, smooth
from ceiling_dso_ros.dso.start.neighbourhood import nearest_neighbours
from ceiling_dso_ros.dso.window.candidates import CandidateTable
from ceiling_dso_ros.dso.window.points import OUTLIER, PointArrays, ResidualArrays, point_arrays, residual_arrays

NEIGHBOURS = 10
OWN_SHARE = 0.2  # of a point's own inverse depth when it is smoothed with its neighbours'
ITERATIONS = (5, 5, 10, 30, 50, 50)  # per level, finest first
OUTLIER_ENERGY = 12.0 * 12.0 * 8 * 4
MIN_DUAL_IDEPTH = 0.05  # of the mean; with less, the plane is seen nearly edge-on
SETTLING_ROUNDS = 3
MIN_POINTS = 100  # with depth, that a map needs
MIN_IN_VIEW = 0.4  # share of the first frame's points
MAX_BRIGHTNESS_CHANGE = 1.2  # |ln gain| beyond the exposures'
MAX_MISFITS = 0.01  # share of the first frame's points that may lack a match, plus as many as left the view
# Share of the image with texture that the first frame did not show: in the next frame, and in later ones.
MAX_NEW_TEXTURE_AT_ONCE, MAX_NEW_TEXTURE = 0.02, 0.1
MAX_RMSE_GROWTH = 1.5  # from one frame to the next; with more, the depths have diverged


@dataclass
class InitializerLevel:
    """Points of the first frame on one pyramid level.

    Attributes:
        points, residuals: struct of arrays; residuals has one target, the new frame.
        count: number of points.
        neighbours: (count, 10) int64 nearest points on the level.
        parents: (count,) int64 nearest point on the next coarser level; empty on the coarsest.
        target: (count,) float32 inverse depth that each point is pulled to.
    """

    points: PointArrays
    residuals: ResidualArrays
    count: int
    neighbours: np.ndarray
    parents: np.ndarray
    target: np.ndarray


def _is_a_way(prediction: CameraMotion) -> bool:
    """Whether a predicted translation is more than its own uncertainty."""
    return bool(np.sum(prediction.T_start_end[:3, 3] ** 2) > np.trace(prediction.covariance[:3, :3]))


def dual_motion(T_frame_first: np.ndarray, plane: np.ndarray) -> Optional[Tuple[np.ndarray, np.ndarray]]:
    """The second motion and plane that give the same homography R + t n^T, to first order in the rotation.

    Translation and plane normal are exchanged: t n^T - n t^T is the rotation n x t.

    Args:
        T_frame_first: (4, 4) motion.
        plane: (3,) n with inverse depth n . (x, y, 1).

    Returns:
        The other motion and plane, the plane with the same inverse depth on the optical axis; None if the plane would
        be behind the camera or the solution is the same.
    """
    t = T_frame_first[:3, 3]
    forward = t[2] * plane[2]
    if abs(t[2]) < 0.2 * np.linalg.norm(t) or forward == 0.0:
        return None
    plane_dual = t * (plane[2] / t[2])
    t_dual = plane * (t[2] / plane[2])
    T_dual = se3.exp(np.concatenate([np.zeros(3), np.cross(plane, t)])) @ T_frame_first
    T_dual[:3, 3] = t_dual
    return T_dual, plane_dual


class Initializer:
    """Aligns frames to a first one until there is parallax enough for a map."""

    def __init__(self, pool: PyramidPool, intrinsics: np.ndarray, config: InitializationConfig) -> None:
        self._pool = pool
        self._intrinsics = intrinsics
        self._config = config
        self.first_slot = -1
        self._levels: List[InitializerLevel] = []

    @property
    def started(self) -> bool:
        """Whether there is a first frame."""
        return self.first_slot >= 0

    @property
    def failed(self) -> bool:
        """Whether another first frame is needed: the last frame could not be aligned, or too many gave no map."""
        brightness = abs(self._light[0] - self._expected_light[0])
        aligned = np.isfinite(self.rmse) and self.in_view > MIN_IN_VIEW and brightness < MAX_BRIGHTNESS_CHANGE
        return not aligned or self._frames >= self._config.max_frames

    def start(self, image_slot: int, selector: PixelSelector) -> None:
        """Take a frame as the first one."""
        self.first_slot = image_slot
        self._pixels: List[SelectedPixels] = []
        self._levels = []
        for level in range(self._pool.shape.levels):
            self._pixels.append(self._select(level, selector))
        for level in range(self._pool.shape.levels - 1, -1, -1):
            self._levels.insert(0, self._make_level(level))
        largest = max(level.count for level in self._levels)
        self._scratch = scratch_memory(1, largest)
        self._T, self._T_before = np.eye(4), np.eye(4)
        self._light, self._expected_light = np.zeros(2), np.zeros(2)
        self._unit = np.inf  # of the depths, in that of the predicted motions
        self._first_textured = self._textured(image_slot)
        self._snapped = False
        self._frames_since_snap = 0
        self._frames = 0
        self.rmse, self.in_view = 0.0, 1.0

    def add(
        self, image_slot: int, exposure_ratio: float, prediction: Optional[CameraMotion] = None
    ) -> Optional[FirstMap]:
        """Align a frame. Returns the map once there was parallax for long enough, else None.

        Args:
            exposure_ratio: exposure of the frame over that of the first one, 1 when unknown.
            prediction: motion from the first frame to this one, predicted by other sensors, in any unit.
        """
        self._frames += 1
        if self._shows_more(image_slot):
            self.rmse = np.inf
            return None
        self._expected_light = np.array([np.log(exposure_ratio), 0.0])
        if self._snapped and prediction is not None and not _is_a_way(prediction):
            prediction = None  # the camera has moved, and who predicts has not noticed: a wheel that is stuck
        expected = self._expected_motion(prediction)
        self._T_before, last_rmse = self._T, self.rmse
        if self._snapped:
            self._align(image_slot, expected, self._expected_light)
        if not self._snapped or self.rmse > MAX_RMSE_GROWTH * last_rmse:
            self._align_flat(image_slot, expected)
        if self._snapped and prediction is not None:
            self._unit = self._unit_of(prediction)
        self._snapped = self._snapped or bool(np.linalg.norm(self._T[:3, 3]) > self._config.min_translation)
        self._frames_since_snap += self._snapped
        if self.failed or not self._enough_parallax():
            return None
        if self._has_depth():
            self._try_dual(image_slot)
        if not self._has_depth() or not self._fits():
            self.rmse = np.inf
            return None
        return self._first_map()

    def _expected_motion(self, prediction: Optional[CameraMotion]) -> np.ndarray:
        """T_frame_first, (4, 4), as predicted or, without a prediction, if the camera goes on as it did."""
        if prediction is None:
            return se3.orthonormalized(self._T @ se3.inverse(self._T_before) @ self._T)
        T = se3.inverse(prediction.T_start_end)
        T[:3, 3] /= self._unit
        return T

    def _unit_of(self, prediction: CameraMotion) -> float:
        """Unit of the depths in that of the predicted motion; infinite while the camera has hardly moved."""
        way, predicted_way = (np.linalg.norm(T[:3, 3]) for T in (self._T, prediction.T_start_end))
        return float(predicted_way / way) if way > self._config.min_translation else np.inf

    def _shows_more(self, image_slot: int) -> bool:
        """Whether a frame has texture where the first one had none, as when a cover slides off the lens.

        The edge of a cover is not part of the scene, and in a narrow view a rotation looks like a translation.
        """
        at_most = MAX_NEW_TEXTURE if self._frames > 1 else MAX_NEW_TEXTURE_AT_ONCE
        return self._textured(image_slot) > self._first_textured + at_most

    def _textured(self, image_slot: int) -> float:
        return textured_share(self._pool.level(image_slot, TEXTURE_LEVEL), *self._pool.shape.sizes[TEXTURE_LEVEL])

    def _align_flat(self, image_slot: int, expected: np.ndarray) -> None:
        """Align a frame as if the scene were a plane perpendicular to the view: with few unknowns this is robust."""
        self._snapped, self._frames_since_snap = False, 0
        for level in self._levels:
            level.points.idepth[: level.count] = 1.0
            level.target[:] = 1.0
        start = expected.copy()
        start[:3, 3] = 0.0
        self._align(image_slot, start, self._expected_light)

    def _enough_parallax(self) -> bool:
        """Enough frames with parallax; two are enough where it grows fast, as with few images a second."""
        if np.linalg.norm(self._T[:3, 3]) > self._config.max_translation:
            return self._frames_since_snap >= 2
        return self._frames_since_snap > self._config.frames_after_snap

    def _has_depth(self) -> bool:
        """Whether enough points of the finest level have a depth, and the motion is finite."""
        level = self._levels[0]
        seen = np.count_nonzero(level.points.idepth_hessian[: level.count] > 0)
        return seen >= MIN_POINTS and bool(np.isfinite(self._T).all())

    def _fits(self) -> bool:
        """Whether the number of points without a match is small enough to be explained by occlusion.

        A motion that moves few points out of view occludes few others. If more points have no match, the motion is
        wrong, as when a cover slid off the lens in the first frame and its edge was taken for a part of the scene.
        """
        level = self._levels[0]
        misfits = np.count_nonzero(level.residuals.state[0, : level.count] == OUTLIER)
        return misfits <= (1.0 - self.in_view + MAX_MISFITS) * level.count

    def _align(self, image_slot: int, T: np.ndarray, light: np.ndarray) -> None:
        """Coarse-to-fine alignment of a frame from a starting motion and brightness."""
        for index in range(len(self._levels) - 1, -1, -1):
            level = self._levels[index]
            if index < len(self._levels) - 1:
                self._inherit(index)
            width, height = self._pool.shape.sizes[index]
            weight = self._config.depth_coupling if self._snapped else self._config.flat_coupling
            T, light, self.rmse, self.in_view = align_level(
                level.points, level.residuals, level.count, self._pool.level(image_slot, index), width, height,
                level_intrinsics(self._intrinsics, index), T, light,
                0.0 if self._snapped else self._config.translation_coupling, level.target, weight,
                OUTLIER_ENERGY, ITERATIONS[index], self._scratch,
            )  # fmt: skip
            self._smooth(level)
        self._pass_up()
        self._T, self._light = T, light

    def _try_dual(self, image_slot: int) -> None:
        """Keep the better one of the two motions by which a plane explains a pair of images."""
        plane = self._fit_plane()
        dual = dual_motion(self._T, plane)
        if dual is None:
            return
        T_dual, plane_dual = dual
        self._settle(image_slot)
        idepths = [self._plane_idepth(index, plane_dual) for index in range(len(self._levels))]
        if any(idepth.min() < MIN_DUAL_IDEPTH * idepth.mean() for idepth in idepths):
            return
        state = copy.deepcopy((self._levels, self._T, self._light, self.rmse, self.in_view))
        for level, idepth in zip(self._levels, idepths):
            level.target[:] = idepth
            level.points.idepth[: level.count] = idepth
            level.points.idepth_hessian[: level.count] = 0
        self._T = T_dual
        self._settle(image_slot)
        if self.rmse > state[3]:
            self._levels, self._T, self._light, self.rmse, self.in_view = state

    def _settle(self, image_slot: int) -> None:
        for _ in range(SETTLING_ROUNDS):
            self._align(image_slot, self._T, self._light)

    def _rays(self, index: int) -> np.ndarray:
        """Viewing rays (x, y, 1) of a level's points, (count, 3) float64."""
        level = self._levels[index]
        u, v = level.points.u[: level.count], level.points.v[: level.count]
        return viewing_rays(level_intrinsics(self._intrinsics, index), u, v)

    def _fit_plane(self) -> np.ndarray:
        """Plane n with idepth = n . ray, (3,), least squares over the informative points of the finest level."""
        level = self._levels[0]
        seen = level.points.idepth_hessian[: level.count] > 0
        rays = self._rays(0)[seen]
        return solve_positive(np.einsum("ij,ik->jk", rays, rays), np.einsum("ij,i->j", rays, level.target[seen]))

    def _plane_idepth(self, index: int, plane: np.ndarray) -> np.ndarray:
        return (self._rays(index) @ plane).astype(np.float32)

    def _select(self, level: int, selector: PixelSelector) -> SelectedPixels:
        width, height = self._pool.shape.sizes[level]
        density = self._config.densities[min(level, len(self._config.densities) - 1)]
        if level == 0:
            return selector.select(self.first_slot, int(density * width * height))
        gradient2 = np.zeros(width * height, np.float32)
        squared_gradient(self._pool.level(self.first_slot, level), width, height, gradient2)
        return strongest_per_cell(gradient2, width, height, density)

    def _make_level(self, level: int) -> InitializerLevel:
        width, height = self._pool.shape.sizes[level]
        pixels = self._pixels[level]
        count = pixels.u.size
        table = CandidateTable(count)
        table.add(pixels, 0, self._pool.level(self.first_slot, level), width)
        points, residuals = point_arrays(count), residual_arrays(1, count)
        points.u[:], points.v[:], points.idepth[:] = pixels.u, pixels.v, 1.0
        points.grey[:], points.weight[:] = table.arrays.grey, table.arrays.weight
        residuals.live[:] = 1
        parents = np.zeros(0, np.int64)
        if level < self._pool.shape.levels - 1:
            coarse = self._pixels[level + 1]
            coarse_size = self._pool.shape.sizes[level + 1]
            parents = nearest_neighbours(
                coarse.u, coarse.v, 0.5 * pixels.u - 0.25, 0.5 * pixels.v - 0.25, *coarse_size, 1
            )[:, 0]
        neighbours = nearest_neighbours(pixels.u, pixels.v, pixels.u, pixels.v, width, height, NEIGHBOURS)
        return InitializerLevel(points, residuals, count, neighbours, parents, np.ones(count, np.float32))

    def _inherit(self, index: int) -> None:
        """Start a level from its own depth where it is known, else from that of the coarser level."""
        level, coarse = self._levels[index], self._levels[index + 1]
        own, parents = level.points.idepth_hessian[: level.count], coarse.points.idepth_hessian[level.parents]
        inherited = coarse.target[level.parents]
        share = parents / (own + parents + 1.0)
        level.target[:] = (1.0 - share) * level.target + share * inherited
        level.points.idepth[: level.count] = level.target

    def _smooth(self, level: InitializerLevel) -> None:
        points, n = level.points, level.count
        smooth(points.idepth[:n], points.idepth_hessian[:n], level.neighbours, OWN_SHARE, level.target)

    def _pass_up(self) -> None:
        """Coarse levels take the information-weighted mean of their children for the next frame."""
        for index in range(len(self._levels) - 1):
            level, coarse = self._levels[index], self._levels[index + 1]
            weight = level.points.idepth_hessian[: level.count]
            total = np.bincount(level.parents, weight, coarse.count)
            mean = np.bincount(level.parents, weight * level.target, coarse.count) / np.maximum(total, 1e-6)
            known = total > 1e-6
            coarse.target[known] = mean[known]
            coarse.points.idepth[: coarse.count] = coarse.target

    def _first_map(self) -> FirstMap:
        level = self._levels[0]
        seen = level.points.idepth_hessian[: level.count] > 0
        unit = float(np.mean(level.target[seen]))
        T = self._T.copy()
        T[:3, 3] *= unit
        pixels = self._pixels[0]
        chosen = np.flatnonzero(seen)
        return FirstMap(
            T_frame_first=T,
            pixels=SelectedPixels(pixels.u[chosen], pixels.v[chosen], pixels.kind[chosen]),
            idepth=level.target[chosen] / np.float32(unit),
            log_gain=float(self._light[0]),
            offset=float(self._light[1]),
        )
