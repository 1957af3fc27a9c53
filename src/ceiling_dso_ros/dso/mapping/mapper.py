# SPDX-License-Identifier: BSD-3-Clause
"""Mapping: traces candidate points in frames, and inserts keyframes into the window."""

import math
from typing import List, Optional, Tuple

import numpy as np

from ceiling_dso_ros.dso.adjustment.bundle_adjustment import BundleAdjustment, marginalize_keyframe
from ceiling_dso_ros.dso.compute.stage_timer import StageTimer
from ceiling_dso_ros.dso.config import OdometryConfig
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.dso.geometry.projection import intrinsic_inverse, intrinsic_matrix, pixel_warp
from ceiling_dso_ros.dso.hosted_points import HostedPoints
from ceiling_dso_ros.dso.images.frame import Frame
from ceiling_dso_ros.dso.images.pyramid import PyramidPool
from ceiling_dso_ros.dso.images.selection import PixelSelector
from ceiling_dso_ros.dso.mapping.activation import Activator
from ceiling_dso_ros.dso.mapping.first_map import FirstMap
from ceiling_dso_ros.dso.mapping.keyframe_policy import PointFate, keyframes_to_marginalize
from ceiling_dso_ros.dso.mapping.map_snapshot import MapSnapshot
from ceiling_dso_ros.dso.mapping.tracing_kernels import trace_host
from ceiling_dso_ros.dso.mapping.vignetting import VignetteEstimator
from ceiling_dso_ros.dso.mapping.window_scale import WindowScale
from ceiling_dso_ros.dso.status import TrackingLostError
from ceiling_dso_ros.dso.stereo.rig import StereoRig
from ceiling_dso_ros.dso.tracking.tracking_reference import ReferenceBuilder, TrackingReference
from ceiling_dso_ros.dso.window.candidates import CandidateTable
from ceiling_dso_ros.dso.window.keyframe_window import FRAME_PARAMETERS, INTRINSICS, KeyframeWindow

MIN_POINTS_FOR_RANGE = 50  # with fewer, the depth of the scene is not known
LEAST_IDEPTH = 1e-6  # 1 / VO unit: as good as infinitely far
# Information that holds the first keyframe of a segment: translation, rotation, a, b.
FIRST_KEYFRAME_INFORMATION = np.array([4e10, 4e10, 4e10, 1e11, 1e11, 1e11, 1e12, 1e8])


class Mapper:
    """Owns the window of keyframes.

    Its memory, which is large, serves one segment after the other: where it was taken anew for each, the heap would be
    in pieces after some days.
    """

    def __init__(
        self, camera: PinholeCamera, config: OdometryConfig, pool: PyramidPool, selector: PixelSelector,
        vignetting: VignetteEstimator, rig: Optional[StereoRig] = None,
    ) -> None:  # fmt: skip
        self._vignetting = vignetting
        self.window = KeyframeWindow(camera, config, pool)
        self._config = config
        self._rig = rig
        self._next_id = 0
        self._selector = selector
        self._adjustment = BundleAdjustment(self.window, config.optimization)
        self._activator = Activator(self.window, config.window.active_points, config.activation)
        self._references = ReferenceBuilder(pool.shape)
        self._max_search = config.tracing.reach * (camera.width + camera.height)

    @property
    def next_id(self) -> int:
        """Identity of the next keyframe; they count up over all segments."""
        return self._next_id

    def begin(self, segment: int, first: Frame, first_map: FirstMap) -> None:
        """Start a segment's map with the initialiser's first frame and its depth, and forget the one before."""
        self._segment = segment
        self._scale = None if self._rig is None else WindowScale(self._rig, self._config.rig)
        self.window.clear()
        self._activator.begin()
        wanted = self._config.window.active_points
        n = first_map.idepth.size
        kept = np.sort(np.random.default_rng(0).permutation(n)[:wanted])
        self._append(first)
        self.window.depths[0] = _median_depth(first_map.idepth[kept])
        prior = self.window.prior.H
        intrinsics = np.arange(INTRINSICS)
        prior[intrinsics, intrinsics] = self._config.optimization.intrinsics_information
        block = INTRINSICS + np.arange(FRAME_PARAMETERS)
        prior[block, block] = FIRST_KEYFRAME_INFORMATION
        pixels = first_map.pixels
        table = CandidateTable(n)  # for the pattern's grey values and weights
        table.add(pixels, 0, self.window.image(0), self.window.width)
        self.window.points.append(
            pixels.u[kept], pixels.v[kept], pixels.kind[kept],
            table.arrays.grey[:, kept], table.arrays.weight[:, kept], first_map.idepth[kept],
            np.zeros(kept.size, np.int64), np.zeros((self.window.points.residuals.live.shape[0], kept.size), np.uint8),
        )  # fmt: skip

    def pose_of(self, keyframe_id: int) -> np.ndarray:
        """T_camera_world of a keyframe in the window."""
        return self.window.keyframes.T_camera_world[self.window.ids.index(keyframe_id)].copy()

    def trace(self, frame: Frame) -> None:
        """Narrow the depth of all candidates with a new frame."""
        window = self.window
        window.pool.correct(frame.image_slot, self._vignetting.vignette)  # it may have changed since the image came
        K, K_inverse = intrinsic_matrix(window.intrinsics), intrinsic_inverse(window.intrinsics)
        ranges = window.candidates.host_ranges(window.count)
        image = window.pool.level(frame.image_slot, 0)
        for host in range(window.count):
            KRKi, Kt = pixel_warp(K, K_inverse, frame.T_camera_world @ window.T_world_camera(host))
            affine = window.keyframes.affine[host]
            gain = frame.exposure / window.keyframes.exposure[host] * np.exp(frame.affine[0] - affine[0])
            trace_host(
                window.candidates.arrays, int(ranges[host]), int(ranges[host + 1]), image, window.width, window.height,
                KRKi, Kt, float(gain), float(frame.affine[1] - gain * affine[1]), self._max_search,
            )  # fmt: skip

    def add_keyframe(self, frame: Frame, timer: StageTimer) -> MapSnapshot:
        """Make a frame, already traced, a keyframe. Returns the refined map.

        Raises:
            TrackingLostError: the bundle adjustment has no solution, or too few points are left.
        """
        window = self.window
        leaving = keyframes_to_marginalize(window, se3.inverse(frame.T_camera_world)[:3, 3], self._config.window)
        self._append(frame)
        window.normal = frame.normal
        window.points.add_target(window.newest)
        with timer.stage("activate"):
            self._activator.activate(window)
        with timer.stage("optimize"):
            rmse = self._adjustment.optimize(window)
        if not np.isfinite(rmse):
            raise TrackingLostError("the bundle adjustment has no solution")
        if window.points.count < self._config.window.min_active_share * self._config.window.active_points:
            raise TrackingLostError(f"{window.points.count} points are too few for a map")
        if self._config.images.vignetting:
            with timer.stage("vignette"):
                self._vignetting.update(window)
        with timer.stage("reference"):
            reference = self._references.build(window)
            window.depths[window.newest] = _median_depth(reference.levels[0].idepth)
        if self._scale is not None:
            with timer.stage("stereo"):
                self._scale.update(window, frame)
        estimates = window.estimates(self._segment, tuple(leaving))
        with timer.stage("marginalize"):
            marginalized = self._retire_points(leaving)
        with timer.stage("select"):
            pixels = self._selector.select(frame.image_slot, self._config.window.candidate_points)
            window.candidates.add(
                pixels, window.newest, window.image(window.newest), window.width, self._idepth_range(reference)
            )
        with timer.stage("marginalize"):
            for slot in reversed(leaving):
                marginalize_keyframe(window, slot, self._adjustment.affine_information)
        return MapSnapshot.of(window, reference, estimates, rmse, marginalized)

    def _idepth_range(self, reference: TrackingReference) -> Tuple[float, float]:
        """Range in which the inverse depths of new candidates are searched: that of the known points, extended."""
        margin = self._config.tracing.depth_margin
        if reference.levels[0].idepth.size < MIN_POINTS_FOR_RANGE:
            return 0.0, np.nan
        low, high = np.quantile(reference.levels[0].idepth, (0.01, 0.99))
        return float(low) / margin, float(high) * margin

    def _append(self, frame: Frame) -> None:
        self.window.add_keyframe(
            self._next_id, frame.stamp_ns, frame.image_slot, frame.T_camera_world, frame.affine, frame.exposure
        )
        self._next_id += 1

    def _retire_points(self, leaving: List[int]) -> HostedPoints:
        """Marginalise or drop the points that leave; returns the marginalised ones."""
        window = self.window
        fate = PointFate(window, leaving, self._config.optimization)
        if fate.marginalize.any():
            self._adjustment.marginalize_points(window, fate.marginalize)
        marginalized = window.hosted_points(fate.marginalize)
        gone = fate.marginalize | fate.drop
        for slot, number in enumerate(
            np.bincount(window.points.arrays.host[: gone.size][gone], minlength=window.count)
        ):
            window.gone_points[slot] += int(number)
        window.points.keep(~gone)
        return marginalized


def _median_depth(idepth: np.ndarray) -> float:
    """Of points with inverse depths (n,); nan when they are too few to know the depth of the scene."""
    return math.nan if idepth.size < MIN_POINTS_FOR_RANGE else 1.0 / max(float(np.median(idepth)), LEAST_IDEPTH)
