# SPDX-License-Identifier: BSD-3-Clause
"""Coarse-to-fine tracking of a new frame against the newest keyframe, from several hypotheses of the motion."""

import itertools
from dataclasses import dataclass
from typing import Iterable, Iterator, List, Optional, Tuple

import numpy as np

from ceiling_dso_ros.dso.config import TrackingConfig
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.geometry.camera_motion import CameraMotion
from ceiling_dso_ros.dso.geometry.projection import level_intrinsics
from ceiling_dso_ros.dso.images.pyramid import PyramidPool
from ceiling_dso_ros.dso.tracking.tracking_kernels import align, mean_squared_flow, pair_greys
from ceiling_dso_ros.dso.tracking.tracking_reference import TrackingReference
from ceiling_dso_ros.dso.tracking.uncertainty import Observability, unit_information

ITERATIONS = (10, 20, 50, 50, 50, 50)  # per level, finest first
MIN_STEP = 0.03  # pixels of the level, at the image's centre
MAX_SATURATED = 0.6  # share of points above the cutoff beyond which it is doubled; on the finest level, a failure
MAX_GAIN_LOG = 2.3  # of an image over the reference: with a tenth of its contrast, 8 bits hold nothing to align
MAX_OFFSET = 200.0
RELIT_HYPOTHESES = 8  # of the motion, that are tried with another brightness
FLOW_STRIDE = 32  # flow is measured on every 32nd point
UNIT_STRIDE = 8
SEARCH_ANGLE = 0.02  # rad
FINE_LEVELS = 2  # on coarser levels a grating may look uniformly grey, or match when shifted by one period


@dataclass(frozen=True)
class TrackedFrame:
    """Result of tracking a frame.

    Attributes:
        T_frame_reference: (4, 4) float64 motion from the reference keyframe's camera to the frame's.
        affine: (2,) brightness (a, b) of the frame.
        rmse: photometric error on the finest level, grey levels.
        saturated: share of points whose error exceeds the cutoff there.
        translation_flow, motion_flow: mean squared flow in pixels^2 by the translation alone, by the whole motion.
        covariance: (6, 6) float64 of (translation, rotation), a left increment on T_frame_reference.
        weakest: squared gradient along the motion that the image determines worst, relative to that of noise.
        weakest_motion: (6,) float64 that motion, a left increment on T_frame_reference that moves the points by one
            pixel, root mean square.
    """

    T_frame_reference: np.ndarray
    affine: np.ndarray
    rmse: float
    saturated: float
    translation_flow: float
    motion_flow: float
    covariance: np.ndarray
    weakest: float
    weakest_motion: np.ndarray


def motion_hypotheses(
    T_last_reference: np.ndarray, T_next_last: np.ndarray, prediction: Optional[CameraMotion] = None
) -> Iterable[np.ndarray]:
    """T_frame_reference to try, likeliest first.

    Args:
        T_last_reference: (4, 4) motion from the reference to the last frame.
        T_next_last: (4, 4) motion from the last frame to this one, if the camera goes on as it did.
        prediction: motion from the last frame to this one, predicted by other sensors, if there is one. If its error
            agrees with its covariance, one of its alternatives is near the true motion.
    """
    velocity = se3.log(T_next_last)
    constant = T_next_last @ T_last_reference
    if prediction is not None:
        yield se3.inverse(prediction.T_start_end) @ T_last_reference
    yield constant
    if prediction is not None:
        for T_last_frame in prediction.alternatives():
            yield se3.inverse(T_last_frame) @ T_last_reference
    yield se3.exp(2.0 * velocity) @ T_last_reference
    yield se3.exp(0.5 * velocity) @ T_last_reference
    yield T_last_reference
    yield np.eye(4)
    for axes in itertools.product((0.0, 1.0, -1.0), repeat=3):
        if any(axes):
            yield se3.exp(SEARCH_ANGLE * np.array([0.0, 0.0, 0.0, *axes])) @ constant


def flow_of(T: np.ndarray, reference: TrackingReference) -> float:
    """Root mean square flow in pixels of the reference's points by a (4, 4) motion."""
    finest = reference.levels[0]
    u, v, idepth = (values[::FLOW_STRIDE] for values in (finest.u, finest.v, finest.idepth))
    return float(np.sqrt(mean_squared_flow(u, v, idepth, reference.intrinsics, T)[1]))


class FrameTracker:
    """Tracks frames. Holds scratch memory and the last error only."""

    def __init__(self, pool: PyramidPool, config: TrackingConfig) -> None:
        self._pool = pool
        self._config = config
        self._system = np.zeros((9, 9))
        self._prior = np.array([config.affine_a_information, config.affine_b_information])

    def track(
        self, image_slot: int, exposure: float, reference: TrackingReference, hypotheses: Iterable[np.ndarray],
        affine: np.ndarray, expected_rmse: float,
    ) -> Optional[TrackedFrame]:  # fmt: skip
        """Track the frame in a pool slot; None when no hypothesis converges.

        If none does well, the light may have changed at once. Then the first ones are tried again with the brightness
        at which the grey values of image and reference are distributed alike.

        Args:
            exposure: of the frame, on the scale of `ExposureScale`.
            hypotheses: T_frame_reference to try in order. The first one is also tried on the finest levels alone, in
                case the coarse levels mislead it.
            affine: first guess of the frame's brightness (a, b).
            expected_rmse: the last frame's; a hypothesis with a similar error is accepted at once.
        """
        growth = self._config.max_rmse_growth
        best: Optional[TrackedFrame] = None
        best_errors = [np.inf] * self._pool.shape.levels
        for hypothesis, light, levels in self._attempts(image_slot, exposure, reference, hypotheses, affine):
            limits = [growth * error for error in best_errors[:levels]]
            errors: List[float] = []
            tracked = self._descend(image_slot, exposure, reference, hypothesis, light, limits, errors)
            if tracked is not None and (best is None or tracked.rmse < best.rmse):
                best, best_errors = tracked, errors[::-1] + best_errors[levels:]
            if best is not None and best.rmse < growth * expected_rmse:
                break
        return best

    def _attempts(
        self, image_slot: int, exposure: float, reference: TrackingReference, hypotheses: Iterable[np.ndarray],
        affine: np.ndarray,
    ) -> Iterator[Tuple[np.ndarray, np.ndarray, int]]:  # fmt: skip
        """What to try: motion, brightness (a, b), and the number of pyramid levels."""
        all_levels, first_ones = self._pool.shape.levels, []
        for k, hypothesis in enumerate(hypotheses):
            yield hypothesis, affine, all_levels
            if k == 0:
                yield hypothesis, affine, FINE_LEVELS
            if k < RELIT_HYPOTHESES:
                first_ones.append(hypothesis)
        for hypothesis in first_ones:
            relit = self._relit(image_slot, exposure, reference, hypothesis, affine)
            if relit is not None:
                yield hypothesis, relit, all_levels

    def _relit(
        self, image_slot: int, exposure: float, reference: TrackingReference, T_frame_reference: np.ndarray,
        tried: np.ndarray,
    ) -> Optional[np.ndarray]:  # fmt: skip
        """Brightness (a, b) of a frame at which its grey values are distributed like the reference's.

        From median and quartiles on the coarsest level: neither depends much on the motion. None where there is
        nothing to compare, or the brightness is as good as the one that was tried, (a, b).
        """
        level = self._pool.shape.levels - 1
        points, size = reference.levels[level], self._pool.shape.sizes[level]
        greys = np.empty((2, points.u.size), np.float32)
        count = pair_greys(
            points.u, points.v, points.idepth, points.grey, self._pool.level(image_slot, level), *size,
            level_intrinsics(reference.intrinsics, level), T_frame_reference, greys,
        )  # fmt: skip
        if count == 0 or not np.isfinite(greys[0, :count]).all():
            return None
        quartiles, expected = (np.quantile(row[:count], (0.25, 0.5, 0.75)) for row in greys)
        if quartiles[0] == quartiles[2] or expected[0] == expected[2]:
            return None
        expected -= reference.affine[1]
        ratio = exposure / reference.exposure
        as_tried = ratio * np.exp(tried[0] - reference.affine[0]) * expected + tried[1]
        if np.abs(quartiles - as_tried).max() < 0.5 * self._config.cutoff:
            return None
        gain = (quartiles[2] - quartiles[0]) / (expected[2] - expected[0])
        return np.array([reference.affine[0] + np.log(gain / ratio), quartiles[1] - gain * expected[1]])

    def _descend(
        self, image_slot: int, exposure: float, reference: TrackingReference, T_frame_reference: np.ndarray,
        affine: np.ndarray, limits: List[float], errors: List[float],
    ) -> Optional[TrackedFrame]:  # fmt: skip
        """Align one hypothesis from coarse to fine, on as many levels as there are limits; None as soon as it fails."""
        T, ab = T_frame_reference, affine
        ratio = exposure / reference.exposure
        saturated = 1.0
        for level in range(len(limits) - 1, -1, -1):
            points = reference.levels[level]
            width, height = self._pool.shape.sizes[level]
            intrinsics = level_intrinsics(reference.intrinsics, level)
            cutoff = self._config.cutoff
            for _ in range(2):
                T, ab, rmse, saturated = align(
                    points.u, points.v, points.idepth, points.grey,
                    self._pool.level(image_slot, level), width, height, intrinsics,
                    T, ab, reference.affine, ratio, self._prior, cutoff, ITERATIONS[level], MIN_STEP / intrinsics[0],
                    self._system,
                )  # fmt: skip
                if saturated <= MAX_SATURATED or level == 0 or not np.isfinite(rmse):
                    break
                cutoff *= 2.0
            errors.append(rmse)
            if not (np.isfinite(rmse) and np.isfinite(T).all()) or rmse > limits[level]:
                return None
        T = se3.orthonormalized(T)  # the next hypotheses are products of it: rounding would grow with every frame
        gain_log = ab[0] - reference.affine[0] + np.log(ratio)
        if saturated > MAX_SATURATED or abs(gain_log) > MAX_GAIN_LOG or abs(ab[1]) > MAX_OFFSET:
            return None
        finest = reference.levels[0]
        flows = mean_squared_flow(
            finest.u[::FLOW_STRIDE], finest.v[::FLOW_STRIDE], finest.idepth[::FLOW_STRIDE], reference.intrinsics, T
        )
        upper = np.triu(self._system[:6, :6])  # below the diagonal nothing is defined
        observability = Observability.of(
            upper + np.triu(upper, 1).T,
            UNIT_STRIDE * unit_information(
                finest.u[::UNIT_STRIDE], finest.v[::UNIT_STRIDE], finest.idepth[::UNIT_STRIDE],
                reference.intrinsics, T,
            ),
            errors[-1],
        )  # fmt: skip
        covariance = observability.covariance(errors[-1])
        weakest_motion = np.sqrt(finest.u.size) * observability.motions[:, 0]
        return TrackedFrame(T, ab, errors[-1], saturated, *flows, covariance, observability.weakest, weakest_motion)
