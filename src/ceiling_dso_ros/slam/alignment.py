# SPDX-License-Identifier: BSD-3-Clause
"""Aligns two views photometrically in the plane, and looks for other motions that explain them as well.

Images are compared without their coarse brightness (a wide blur is subtracted): lamps that are on or off change that.
"""

import math
from dataclasses import dataclass
from typing import Callable, List, Optional, Sequence, Tuple

import cv2
import numpy as np

from ceiling_dso_ros.dso.geometry.projection import level_intrinsics
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.slam.alignment_kernels import UNKNOWNS, add_normal_equations, correlations, grey_of
from ceiling_dso_ros.slam.records import KeyframeRecord, RecordCamera, T_upright_camera

LEVELS = 3
WIDE_BLUR_PX = 5.0  # on each level
HUBER = 6.0  # grey levels
ITERATIONS = 12
CLOSE = np.array([2e-4, 2e-4, 2e-5])  # metres, rad
FEWEST_POINTS = 60
SEARCH_LEVEL = 1
SEARCH_POINTS = 200
SEARCH_STEP_PX = 1.5
PEAK_PX = 4.0  # closer shifts belong to the same alignment
SEARCH_YAWS = (0.0, math.pi / 2, math.pi, -math.pi / 2)
SEARCH_SHARE = 0.4  # of the points in view that must be in view after a shift
RELATED_PIXELS = 6.0  # neighbouring residuals are not independent: so many count as one
YAW_SIGMA_RAD = 1e-3  # by which depths that are wrong turn an alignment


@dataclass(frozen=True)
class PreparedView:
    """A record's image pyramid, its camera for the kernels, and the grey values of its points, on each level."""

    record: KeyframeRecord
    cameras: Sequence[np.ndarray]
    levels: Sequence[np.ndarray]
    greys: Sequence[np.ndarray]


@dataclass(frozen=True)
class Alignment:
    """A photometric alignment.

    Attributes:
        motion: (3,) T_a_b.
        covariance: (3, 3) of it, as in `fusion.planar`, with the errors of both tilts.
        sigma_m: of its shift along the less certain axis, by the images alone.
        correlation: of the grey values, the smaller one of both directions.
        points: in view, of both directions together.
    """

    motion: np.ndarray
    covariance: np.ndarray
    sigma_m: float
    correlation: float
    points: int


class Aligner:
    """Aligns views of one camera."""

    def __init__(self, camera: RecordCamera) -> None:
        self._T_base_camera = camera.T_base_camera
        self._intrinsics = [level_intrinsics(camera.camera.parameters, level) for level in range(LEVELS)]
        self.sizes: List[Tuple[int, int]] = []
        for level in range(LEVELS):
            self.sizes.append((camera.camera.width // 2**level, camera.camera.height // 2**level))

    def prepare(self, record: KeyframeRecord) -> PreparedView:
        """Compute what alignments need of a record."""
        levels, greys = [], []
        T_camera_upright = np.linalg.inv(T_upright_camera(record.tilt, self._T_base_camera))
        cameras = [np.concatenate([T_camera_upright[:3].ravel(), intrinsics]) for intrinsics in self._intrinsics]
        image = record.image.astype(np.float32)
        for level, (width, height) in enumerate(self.sizes):
            if level:
                image = cv2.resize(image[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA)
            fine = image - cv2.GaussianBlur(image, (0, 0), WIDE_BLUR_PX)
            levels.append(np.ascontiguousarray(fine).ravel())
            greys.append(grey_of(record.points, levels[-1], width, height, cameras[level]))
        return PreparedView(record, cameras, levels, greys)

    def pixel_m(self, height_m: float, level: int) -> float:
        """What a pixel of a level covers at a height above the floor."""
        return float((height_m - self._T_base_camera[2, 3]) / self._intrinsics[level][0])

    def align(self, a: PreparedView, b: PreparedView, guess: np.ndarray) -> Optional[Alignment]:
        """Refine a motion T_a_b from coarse to fine; None if the views overlap too little or it does not converge."""
        motion, affine = np.array(guess, np.float64), np.array([[1.0, 0.0], [1.0, 0.0]])
        H, sums = np.zeros((UNKNOWNS, UNKNOWNS)), np.zeros(3)
        for level in reversed(range(LEVELS)):
            for _ in range(ITERATIONS):
                solved = self._step(a, b, level, motion, affine)
                if solved is None:
                    return None
                step, H, sums = solved
                motion = planar.compose(motion, step)
                if (np.abs(step) < CLOSE).all():
                    break
        forth, back = self._correlation(a, b, motion), self._correlation(b, a, planar.inverse(motion))
        by_images = RELATED_PIXELS * sums[0] / max(sums[1], 1.0) * np.linalg.inv(H[:3, :3])
        sigma_m = float(np.sqrt(np.linalg.eigvalsh(by_images[:2, :2])[1]))
        covariance = by_images + _beside_images(a.record, b.record, motion[2])
        return Alignment(motion, covariance, sigma_m, min(forth[0], back[0]), int(forth[1] + back[1]))

    def others(
        self, a: PreparedView, b: PreparedView, found: Alignment, share: float,
        admits: Optional[Callable[[np.ndarray], np.ndarray]] = None,
    ) -> np.ndarray:  # fmt: skip
        """Other motions T_a_b under which the views agree nearly as well, (K, 3), the best first.

        Args:
            a, b: the views.
            found: the alignment.
            share: of its correlation, from which on another motion counts.
            admits: says which of (N, 3) motions are possible, (N,) bool; all by default.
        """
        level, height_m = SEARCH_LEVEL, a.record.height_m
        pixel_m = self.pixel_m(height_m, level)
        width, height = self.sizes[level]
        chosen = np.linspace(0, len(a.record.points) - 1, min(SEARCH_POINTS, len(a.record.points))).astype(np.int64)
        points, grey = a.record.points[chosen], a.greys[level][chosen]
        image, camera = b.levels[level], b.cameras[level]
        best = correlations(points, grey, image, width, height, camera, found.motion[None])[0]
        shifts = self._shifts(pixel_m)
        middle = _middle(b.cameras[0], height_m)
        result = []
        for turn in SEARCH_YAWS:
            turned = _turned_about(found.motion, middle, turn)
            motions = np.repeat(turned[None], len(shifts), axis=0)
            motions[:, :2] += shifts @ planar.rotation(turned[2]).T
            motions = motions if admits is None else motions[admits(motions)]
            scores = correlations(points, grey, image, width, height, camera, motions)
            apart = np.hypot(*(motions - found.motion)[:, :2].T) if turn == 0.0 else np.full(len(motions), np.inf)
            likely = (
                (scores[:, 0] > share * best[0]) & (scores[:, 1] > SEARCH_SHARE * best[1]) & (apart > PEAK_PX * pixel_m)
            )
            result += [(score, motion) for score, motion in zip(scores[likely, 0], motions[likely])]
        result.sort(key=lambda entry: -entry[0])
        return np.array([motion for _, motion in result]).reshape(-1, 3)

    def _shifts(self, pixel_m: float) -> np.ndarray:
        """(M, 2) shifts in the plane, along the axes of the image, that leave the wanted share of a view in view."""
        x, y = (
            np.arange(-(1.0 - SEARCH_SHARE) * side, (1.0 - SEARCH_SHARE) * side, SEARCH_STEP_PX) * pixel_m
            for side in self.sizes[SEARCH_LEVEL]
        )
        axes = self._T_base_camera[:2, :2].T
        return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2) @ axes

    def _step(
        self, a: PreparedView, b: PreparedView, level: int, motion: np.ndarray, affine: np.ndarray
    ) -> Optional[Tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """A Gauss-Newton step of the motion; the gains and offsets of both directions are changed in place."""
        H, g, sums = np.zeros((UNKNOWNS, UNKNOWNS)), np.zeros(UNKNOWNS), np.zeros(3)
        for number, (points, image, forth) in enumerate(((a, b, True), (b, a, False))):
            H_one, g_one = np.zeros((UNKNOWNS, UNKNOWNS)), np.zeros(UNKNOWNS)
            part = add_normal_equations(
                points.record.points, points.greys[level], image.levels[level], *self.sizes[level],
                image.cameras[level], motion, forth, affine[number], HUBER, H_one, g_one,
            )  # fmt: skip
            if part[2] < FEWEST_POINTS // 2:
                return None
            # the gain and offset of a direction are its own: eliminated here
            own = H_one[3:, 3:] + 1e-6 * np.eye(2)
            to_own = H_one[:3, 3:] @ np.linalg.inv(own)
            affine[number] -= np.linalg.solve(own, g_one[3:])
            H[:3, :3] += H_one[:3, :3] - to_own @ H_one[3:, :3]
            g[:3] += g_one[:3] - to_own @ g_one[3:]
            sums += part
        if np.linalg.eigvalsh(H[:2, :2])[0] <= 0.0:
            return None
        step = -np.linalg.solve(H[:3, :3] + 1e-9 * np.eye(3), g[:3])
        longest = 2.0 * self.pixel_m(a.record.height_m, level)
        size = float(np.hypot(*step[:2]))
        return step * min(1.0, longest / max(size, 1e-12)), H, sums

    def _correlation(self, a: PreparedView, b: PreparedView, motion: np.ndarray) -> np.ndarray:
        """Not of the finest level, on which noise and lines finer than a pixel decide."""
        level = SEARCH_LEVEL
        return correlations(
            a.record.points, a.greys[level], b.levels[level], *self.sizes[level], b.cameras[level], motion[None]
        )[0]


def _middle(camera: np.ndarray, height_m: float) -> np.ndarray:
    """Where the middle of a view lies, (2,), by its (16,) camera of `alignment_kernels`."""
    R, t = camera[:12].reshape(3, 4)[:, :3], camera[[3, 7, 11]]
    centre, axis = -R.T @ t, R[2]
    return (centre + axis * (height_m - centre[2]) / axis[2])[:2]


def _beside_images(a: KeyframeRecord, b: KeyframeRecord, yaw: float) -> np.ndarray:
    """(3, 3) covariance of a motion T_a_b with a yaw by the errors of both tilts, and of depths."""
    result = np.zeros((3, 3))
    result[:2, :2] = _shifted_by_tilt(b) + planar.rotation(-yaw) @ _shifted_by_tilt(a) @ planar.rotation(yaw)
    result[2, 2] = YAW_SIGMA_RAD**2
    return result


def _shifted_by_tilt(record: KeyframeRecord) -> np.ndarray:
    """(2, 2) covariance of the shift of the ceiling by an error of the tilt: pitch along x, roll along y."""
    roll, pitch = record.tilt.sigmas
    return np.diag([pitch * record.height_m, roll * record.height_m]) ** 2


def _turned_about(motion: np.ndarray, middle: np.ndarray, turn: float) -> np.ndarray:
    """The motion T_a_b after turning b about a point of its own, (2,): the middle of the view stays."""
    centre = motion[:2] + planar.rotation(motion[2]) @ middle
    yaw = motion[2] + turn
    return np.array([*(centre - planar.rotation(yaw) @ middle), planar.wrap(yaw)])
