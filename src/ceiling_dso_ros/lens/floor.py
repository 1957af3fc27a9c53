# SPDX-License-Identifier: BSD-3-Clause
"""What is known of the base's poses: the floor is nearly flat, and the wheels measure the motion over it."""

from dataclasses import dataclass
from typing import NamedTuple, Sequence, Tuple

import numpy as np

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.calibration_data import ImagePair, WheelPath
from ceiling_dso_ros.lens.sightings import cross_matrices
from ceiling_dso_ros.lens.state import OF_KEYFRAME, WHEELS, DriveState

STEP = 1e-6  # of numeric derivatives: seconds, and logarithms of ratio and base


class Terms(NamedTuple):
    """Residuals (n, 3), whitened, with their derivatives by few unknowns.

    Attributes:
        residual: (n, 3).
        unknowns: (n, k) int64 unknowns that they depend on.
        derivative: (n, 3, k).
        time: (n,) int64 keyframe to which each belongs.
    """

    residual: np.ndarray
    unknowns: np.ndarray
    derivative: np.ndarray
    time: np.ndarray


def of_keyframe(offset: int, keyframes: np.ndarray) -> np.ndarray:
    """(n, 6) numbers of the unknowns of keyframes, (n,); offset is that of the first one."""
    return offset + OF_KEYFRAME * keyframes[:, None] + np.arange(OF_KEYFRAME)


def roughness(poses: np.ndarray) -> np.ndarray:
    """(K, 3) height in metres, and tilt about y and x of the base in rad, of poses (K, 4, 4)."""
    return np.column_stack([poses[:, 2, 3], -poses[:, 2, 0], poses[:, 2, 1]])


def floor_terms(state: DriveState, sigmas: np.ndarray, offset: int) -> Terms:
    """The floor is flat up to sigmas, (3,) as in `roughness`."""
    poses = state.T_world_base
    derivative = np.zeros((len(poses), 3, OF_KEYFRAME))
    derivative[:, 0, :3] = poses[:, 2, :3]
    # the third row of R exp(w) is that of R plus (R_3 x w), with R_3 nearly (0, 0, 1)
    by_turn = cross_matrices(poses[:, 2, :3])
    derivative[:, 1, 3:], derivative[:, 2, 3:] = -by_turn[:, 0], by_turn[:, 1]
    numbers = np.arange(len(poses))
    return Terms(roughness(poses) / sigmas, of_keyframe(offset, numbers), derivative / sigmas[:, None], numbers)


@dataclass(frozen=True)
class WheelPairs:
    """Pairs of keyframes between which the wheels' motion is compared.

    Attributes:
        wheels: the wheels' path.
        pairs: (n) pairs as a calibration has them.
        keyframes: (n, 2) int64 their keyframes.
    """

    wheels: WheelPath
    pairs: Sequence[ImagePair]
    keyframes: np.ndarray

    def moved(self, state: DriveState) -> np.ndarray:
        """(n, 3) planar motions of the base between the keyframes of each pair."""
        first, second = (state.T_world_base[self.keyframes[:, side]] for side in (0, 1))
        back = np.swapaxes(first[:, :3, :3], 1, 2)
        turn = back @ second[:, :3, :3]
        shift = np.einsum("nij,nj->ni", back, second[:, :3, 3] - first[:, :3, 3])
        return np.column_stack([shift[:, :2], np.arctan2(turn[:, 1, 0], turn[:, 0, 0])])

    def residuals(self, state: DriveState) -> np.ndarray:
        """(n, 3) motion of the base minus that of the wheels: x, y in metres and yaw in rad."""
        difference = self.moved(state) - self.wheels.motions(self.pairs, *state.wheels)
        difference[:, 2] = np.angle(np.exp(1j * difference[:, 2]))
        return difference

    def terms(self, state: DriveState, sigmas: np.ndarray, weights: np.ndarray, offset: int) -> Terms:
        """The residuals over sigmas (3,), each pair with a weight, (n,)."""
        first, second = (state.T_world_base[self.keyframes[:, side]] for side in (0, 1))
        back = np.swapaxes(first[:, :3, :3], 1, 2)
        turn = back @ second[:, :3, :3]
        shift = np.einsum("nij,nj->ni", back, second[:, :3, 3] - first[:, :3, 3])
        derivative = np.zeros((len(shift), 3, 2 * OF_KEYFRAME + 3))
        derivative[:, 0, 0] = derivative[:, 1, 1] = -1.0
        derivative[:, :2, 3:6] = cross_matrices(shift)[:, :2]
        derivative[:, :2, 6:9] = turn[:, :2]
        ahead = turn[:, :, 0]  # the yaw is that of this axis
        by_axis = np.zeros((len(shift), 1, 3))
        by_axis[:, 0, :2] = np.column_stack([-ahead[:, 1], ahead[:, 0]]) / np.square(ahead[:, :2]).sum(axis=1)[:, None]
        derivative[:, 2:, 3:6] = by_axis @ cross_matrices(ahead)
        derivative[:, 2:, 9:12] = by_axis @ turn @ cross_matrices(-np.eye(3)[:1])
        for number, step in enumerate(STEP * np.eye(3)):
            more, less = (self.wheels.motions(self.pairs, *(state.wheels + sign * step)) for sign in (1.0, -1.0))
            derivative[:, :, 2 * OF_KEYFRAME + number] = (less - more) / (2.0 * STEP)
        index = np.concatenate(
            [
                of_keyframe(offset, self.keyframes[:, 0]),
                of_keyframe(offset, self.keyframes[:, 1]),
                np.tile(np.arange(WHEELS.start, WHEELS.stop), (len(shift), 1)),
            ],
            axis=1,
        )
        roots = np.sqrt(weights)[:, None]
        whitened = derivative / sigmas[:, None] * roots[:, :, None]
        return Terms(self.residuals(state) / sigmas * roots, index, whitened, self.keyframes[:, 0])

    def excess_m(self, state: DriveState, half_base_m: float) -> Tuple[np.ndarray, np.ndarray]:
        """(n, 3) as `calibration_problem.Solution` has it, and (n,) the way that the wheels turned, metres."""
        by_wheels = self.wheels.motions(self.pairs, *state.wheels)
        arcs = [planar.logmap(w) - planar.logmap(c) for w, c in zip(by_wheels, self.moved(state))]
        forward, left, turn = np.array(arcs).T
        half = half_base_m * np.exp(state.wheels[2])
        way = np.hypot(*by_wheels[:, :2].T) + half_base_m * np.abs(by_wheels[:, 2])
        return np.column_stack([forward - half * turn, forward + half * turn, left]), way


def add_terms(terms: Terms, H: np.ndarray, scores: np.ndarray, cluster: np.ndarray) -> None:
    """Add to the normal equations; H (N, N) and scores (C, N) are changed, cluster (K,) is that of each keyframe."""
    products = np.einsum("nki,nkj->nij", terms.derivative, terms.derivative)
    np.add.at(H, (terms.unknowns[:, :, None], terms.unknowns[:, None, :]), products)
    gradients = np.einsum("nki,nk->ni", terms.derivative, terms.residual)
    np.add.at(scores, (cluster[terms.time][:, None], terms.unknowns), gradients)
