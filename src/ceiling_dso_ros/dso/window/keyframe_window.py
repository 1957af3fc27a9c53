# SPDX-License-Identifier: BSD-3-Clause
"""The window of keyframes: poses, brightness and intrinsics with their linearisation points, points and candidates."""

import math
from typing import List, NamedTuple, Optional, Tuple

import numpy as np

from ceiling_dso_ros.dso.compute.struct_of_arrays import struct_of_arrays
from ceiling_dso_ros.dso.config import OdometryConfig
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.dso.geometry.projection import viewing_rays
from ceiling_dso_ros.dso.hosted_points import HostedPoints
from ceiling_dso_ros.dso.images.pyramid import PyramidPool
from ceiling_dso_ros.dso.status import NO_SCALE, KeyframeEstimate, ScaleMeasurement
from ceiling_dso_ros.dso.window.candidates import CandidateTable
from ceiling_dso_ros.dso.window.points import PointTable

INTRINSICS = 4
FRAME_PARAMETERS = 8  # translation, rotation, a, b
FIRST_ENERGY_THRESHOLD = 8.0 * 8.0 * 8.0


@struct_of_arrays
class KeyframeArrays(NamedTuple):
    """Keyframes as a struct of arrays; slot 0 is the oldest.

    The estimate is T_camera_world = exp(offset[:6]) T_camera_world_eval and affine = affine_eval + offset[6:]: the
    evaluation point stays where the window's prior was linearised, the offset moves.

    Attributes:
        T_camera_world_eval: (slots, 4, 4) float64.
        affine_eval: (slots, 2) float64 brightness (a, b).
        offset: (slots, 8) float64.
        T_camera_world: (slots, 4, 4) float64, current estimate.
        affine: (slots, 2) float64, current estimate.
        exposure: (slots,) float64 on the scale of `ExposureScale`.
        energy_threshold: (slots,) float32; residuals above it are outliers.
        image_slot: (slots,) int64 slot in the pyramid pool.
    """

    T_camera_world_eval: np.ndarray
    affine_eval: np.ndarray
    offset: np.ndarray
    T_camera_world: np.ndarray
    affine: np.ndarray
    exposure: np.ndarray
    energy_threshold: np.ndarray
    image_slot: np.ndarray


class Prior(NamedTuple):
    """Quadratic energy 1/2 x^T H x + b^T x on the offsets x of (intrinsics, keyframe 0, keyframe 1, ...)."""

    H: np.ndarray
    b: np.ndarray


class KeyframeWindow:
    """All variables of the bundle adjustment; its memory serves one map after the other."""

    def __init__(self, camera: PinholeCamera, config: OdometryConfig, pool: PyramidPool) -> None:
        slots = config.window.max_keyframes + 1
        self.pool = pool
        self.width, self.height = camera.width, camera.height
        self._calibrated_intrinsics = camera.parameters
        self.keyframes = KeyframeArrays(
            T_camera_world_eval=np.zeros((slots, 4, 4)),
            affine_eval=np.zeros((slots, 2)),
            offset=np.zeros((slots, FRAME_PARAMETERS)),
            T_camera_world=np.zeros((slots, 4, 4)),
            affine=np.zeros((slots, 2)),
            exposure=np.ones(slots),
            energy_threshold=np.zeros(slots, np.float32),
            image_slot=np.zeros(slots, np.int64),
        )
        self.points = PointTable(slots, 3 * config.window.active_points)
        self.candidates = CandidateTable(2 * slots * config.window.candidate_points)
        self.clear()

    def clear(self) -> None:
        """Forget all keyframes with their points; their images are left to who gives up the map."""
        self.ids: List[int] = []
        self.stamps_ns: List[int] = []
        self.gone_points: List[int] = []  # active points that each keyframe has lost
        self.depths: List[float] = []  # of the map as each keyframe saw it when it was made
        self.scales: List[ScaleMeasurement] = []  # by the second camera, then
        self.points.clear()
        self.candidates.count = 0
        self.intrinsics_eval = self._calibrated_intrinsics
        self.intrinsics_offset = np.zeros(INTRINSICS)
        self.normal: Optional[np.ndarray] = None  # (3,) of the plane in which the camera moves, in its own frame
        self.prior = Prior(np.zeros((INTRINSICS, INTRINSICS)), np.zeros(INTRINSICS))

    @property
    def count(self) -> int:
        """Keyframes in the window."""
        return len(self.ids)

    @property
    def newest(self) -> int:
        """Slot of the newest keyframe."""
        return len(self.ids) - 1

    @property
    def intrinsics(self) -> np.ndarray:
        """Current (fx, fy, cx, cy), float64."""
        return self.intrinsics_eval + self.intrinsics_offset

    @property
    def offsets(self) -> np.ndarray:
        """Offset from the evaluation point of (intrinsics, keyframes), float64."""
        return np.concatenate([self.intrinsics_offset, self.keyframes.offset[: self.count].ravel()])

    def image(self, slot: int) -> np.ndarray:
        """Level 0 of a keyframe's image, flat float32."""
        return self.pool.level(int(self.keyframes.image_slot[slot]), 0)

    def T_world_camera(self, slot: int) -> np.ndarray:
        """Current pose of a keyframe, (4, 4) float64."""
        return se3.inverse(self.keyframes.T_camera_world[slot])

    def add_keyframe(
        self, keyframe_id: int, stamp_ns: int, image_slot: int, T_camera_world: np.ndarray,
        affine: np.ndarray, exposure: float,
    ) -> None:  # fmt: skip
        """Append a keyframe; its evaluation point is its pose."""
        slot = self.count
        self.ids.append(keyframe_id)
        self.stamps_ns.append(stamp_ns)
        self.gone_points.append(0)
        self.depths.append(math.nan)
        self.scales.append(NO_SCALE)
        self.keyframes.T_camera_world[slot], self.keyframes.affine[slot] = T_camera_world, affine
        self.keyframes.exposure[slot], self.keyframes.image_slot[slot] = exposure, image_slot
        self.keyframes.energy_threshold[slot] = FIRST_ENERGY_THRESHOLD
        self.relinearize(slot)
        size = INTRINSICS + FRAME_PARAMETERS * self.count
        H, b = np.zeros((size, size)), np.zeros(size)
        H[:-FRAME_PARAMETERS, :-FRAME_PARAMETERS], b[:-FRAME_PARAMETERS] = self.prior
        self.prior = Prior(H, b)

    def relinearize(self, slot: int) -> None:
        """Move a keyframe's evaluation point to its estimate. Only valid while the prior does not contain it."""
        self.keyframes.T_camera_world_eval[slot] = se3.orthonormalized(self.keyframes.T_camera_world[slot])
        self.keyframes.affine_eval[slot] = self.keyframes.affine[slot]
        self.keyframes.offset[slot] = 0.0

    def move(self, step: np.ndarray) -> None:
        """Add a step of (intrinsics, keyframes), float64, to the offsets."""
        self.intrinsics_offset += step[:INTRINSICS]
        for slot in range(self.count):
            first = INTRINSICS + FRAME_PARAMETERS * slot
            self.keyframes.offset[slot] += step[first : first + FRAME_PARAMETERS]
            offset = self.keyframes.offset[slot]
            self.keyframes.T_camera_world[slot] = se3.exp(offset[:6]) @ self.keyframes.T_camera_world_eval[slot]
            self.keyframes.affine[slot] = self.keyframes.affine_eval[slot] + offset[6:]

    def remove_keyframe(self, slot: int) -> None:
        """Remove a keyframe with its points, candidates and image. The prior must not contain it any more."""
        self.pool.release(int(self.keyframes.image_slot[slot]))
        for array in self.keyframes:
            array[slot:-1] = array[slot + 1 :]
        for values in (self.ids, self.stamps_ns, self.gone_points, self.depths, self.scales):
            del values[slot]
        self.points.remove_keyframe(slot)
        self.candidates.remove_host(slot)

    def estimates(self, segment: int, leaving: Tuple[int, ...] = ()) -> Tuple[KeyframeEstimate, ...]:
        """The current keyframes; `leaving` are the slots that are about to be marginalised."""
        return tuple(
            KeyframeEstimate(
                keyframe_id=self.ids[slot],
                stamp_ns=self.stamps_ns[slot],
                segment=segment,
                T_world_camera=self.T_world_camera(slot),
                affine=(float(self.keyframes.affine[slot, 0]), float(self.keyframes.affine[slot, 1])),
                leaves=slot in leaving,
                depth=self.depths[slot],
                scale=self.scales[slot],
            )
            for slot in range(self.count)
        )

    def hosted_points(self, chosen: np.ndarray) -> HostedPoints:
        """Those of the points whose mask, (points,) bool, is True and whose inverse depth is positive."""
        arrays, count = self.points.arrays, self.points.count
        indices = np.flatnonzero(chosen & (arrays.idepth[:count] > 0.0))
        u, v, idepth = (array[indices].astype(np.float64) for array in (arrays.u, arrays.v, arrays.idepth))
        return HostedPoints(
            keyframe_id=np.array(self.ids, np.int64)[arrays.host[indices]],
            position_camera=viewing_rays(self.intrinsics, u, v) / idepth[:, None],
            grey=arrays.grey[:, :count].mean(axis=0)[indices],  # ten times faster than the mean of those chosen
        )
