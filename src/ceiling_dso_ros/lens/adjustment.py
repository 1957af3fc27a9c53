# SPDX-License-Identifier: BSD-3-Clause
"""Bundle adjustment of a whole drive: lens, mount, clock and wheels together with all poses and points.

Gauss-Newton with Levenberg's damping; points are eliminated. Weights are those of Student's t distribution, because
some sightings are wrong. How rough the floor is and how well wheels and images measure is estimated as well.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple, Optional, Tuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.dso.compute.scatter import median_scatter
from ceiling_dso_ros.dso.durations import seconds
from ceiling_dso_ros.lens.elimination_kernels import Equations, add_sightings, point_steps, sighting_scores
from ceiling_dso_ros.lens.floor import WheelPairs, add_terms, floor_terms, roughness
from ceiling_dso_ros.lens.parameters import vector_of
from ceiling_dso_ros.lens.sightings import derivatives, residuals
from ceiling_dso_ros.lens.state import LENS, MOUNT, OF_DRIVE, OF_KEYFRAME, WHEELS, DriveState
from ceiling_dso_ros.lens.tracks import Tracks

FREEDOM = 4.0  # of Student's t, of the sightings and of the wheels
HOST_SLACK_PX = 0.5  # a point may be beside the corner in which it was found: along an edge, nothing else holds it
MODEL_PX = 0.03  # what a sighting is wrong by beside its noise: interpolation, and patches that are not flat
IDEPTH_SLACK = 0.5  # relative to the first guess, for points that nothing else tells
GAUGE = 1e12  # information of where each segment begins
WEAK = 1e-2  # information that keeps keyframes without sightings solvable
CLUSTER_S = 2.0  # errors of sightings that are closer in time may have the same cause
LAGS = 3  # neighbours of such a stretch whose errors may still have the same cause
PARTS = (6, 4)  # of the image, across and down
PART_SHIFT = 7e-5  # of the image's width: by so much a lens may be other than its model in each part of the image
FIRST_FLOOR = np.array([2e-3, 3e-3, 3e-3])  # m, rad, rad
LEAST_FLOOR = np.array([2e-5, 2e-5, 2e-5])
# m, m, rad for each pair: as of good wheels, because from too large a value the noise is not found
FIRST_WHEELS = np.array([2e-4, 2e-4, 2e-4])
LEAST_WHEELS = np.array([5e-5, 5e-5, 5e-5])
STEPS = 8  # of Gauss-Newton for each estimate of the noise
SMALL = 0.02  # decrease of the cost by a step, which is that of half a square of a standard deviation: no more steps
FIRST_DAMPING = 1e-5


class Noise(NamedTuple):
    """Standard deviations: floor (3,) and wheels (3,) as in `floor`, and the factor on those of the sightings."""

    floor: np.ndarray
    wheels: np.ndarray
    sightings: float


@dataclass(frozen=True)
class Prior:
    """What is known before: values (15,) and their information (15, 15); see `state`.

    The mount's rotation is relative to the nominal one.
    """

    state: DriveState
    information: np.ndarray

    def deviation(self, state: DriveState) -> np.ndarray:
        """(15,) how far a state is from the prior's values."""
        turn = state.T_base_camera[:3, :3] @ self.state.T_base_camera[:3, :3].T
        result = np.zeros(OF_DRIVE)
        result[LENS] = vector_of(state.lens) - vector_of(self.state.lens)
        result[MOUNT] = [
            *(state.T_base_camera - self.state.T_base_camera)[:3, 3],
            *Rotation.from_matrix(turn).as_rotvec(),
        ]
        result[WHEELS] = state.wheels - self.state.wheels
        return result


class _System(NamedTuple):
    H: np.ndarray
    scores: np.ndarray
    whitened: Equations


class Adjustment:
    """The problem of one drive."""

    def __init__(
        self, tracks: Tracks, stamps_ns: np.ndarray, segments: np.ndarray, wheels: WheelPairs, prior: Prior,
        idepth: np.ndarray,
    ) -> None:  # fmt: skip
        """Prepare.

        Args:
            tracks: the sightings.
            stamps_ns: (K,) int64 of the keyframes, nanoseconds.
            segments: (K,) int64 of the keyframes.
            wheels: the pairs of keyframes with the wheels' motion.
            prior: of lens, mount, clock and wheels.
            idepth: (P,) first guess, 1 / m.
        """
        self.tracks, self.wheels, self.prior = tracks, wheels, prior
        self.used = np.ones(len(wheels.keyframes), bool)  # pairs between which the wheels did not slip
        self._first_idepth = idepth
        cluster_s = seconds(stamps_ns - stamps_ns[0]) / CLUSTER_S
        self._cluster = np.unique(cluster_s.astype(np.int64), return_inverse=True)[1].astype(np.int64)
        self._held = np.flatnonzero(np.diff(segments, prepend=segments[0] - 1))
        self._size = OF_DRIVE + OF_KEYFRAME * len(stamps_ns)
        self._root = _roots(tracks.information)
        slack = np.eye(2) / HOST_SLACK_PX**2
        self._host_information = _softened(tracks.host_information) + slack

    def solve(self, state: DriveState, noise: Noise, rounds: int) -> Tuple[DriveState, Noise]:
        """Iterate; each round ends with a new estimate of the noise."""
        for _ in range(rounds):
            state = self._descend(state, noise)
            noise = self._noise(state, noise)
        return state, noise

    def covariance(self, state: DriveState, noise: Noise) -> np.ndarray:
        """(15, 15) covariance of the unknowns of the drive.

        It is that of the model of the noise, with each standard deviation as large as errors have in fact where that is
        more (sandwich). Errors that are close to each other, in time or in the image, may have the same cause: so the
        gradients of all that happened within CLUSTER_S are added up, and those of all that was seen in a part of the
        image. On top comes what the solution would make of a lens that is other than its model by PART_SHIFT in each
        part: residuals do not show it where the unknowns take it up. The correlations stay those of the model.
        """
        system = self._system(state, noise)
        chosen = cho_solve(cho_factor(system.H), np.eye(self._size)[:, :OF_DRIVE])
        parts = self._parts(self.tracks.pixel, state), self._parts(self.tracks.host_pixel, state)
        of_parts = self._scores_of(system, parts) @ chosen
        in_fact = np.maximum(_variance_of_sum(system.scores @ chosen, LAGS), _variance_of_sum(of_parts, 0))
        in_fact = in_fact + sum(
            np.square(self._scores_of(self._shifted(system, state, noise, shift), parts) @ chosen).sum(axis=0)
            for shift in PART_SHIFT * state.lens.width * np.eye(2)
        )
        modelled = chosen[:OF_DRIVE]
        # the prior's values are one draw: its own information stands for its score
        in_fact += np.diag(modelled.T @ self.prior.information @ modelled)
        larger = np.sqrt(np.maximum(in_fact / np.diag(modelled), 1.0))
        return larger[:, None] * modelled * larger

    def _parts(self, pixels: np.ndarray, state: DriveState) -> np.ndarray:
        """(N,) in which part of the image pixels (N, 2) are."""
        size = np.array([state.lens.width, state.lens.height])
        column, row = np.clip(pixels / size * PARTS, 0, np.array(PARTS) - 1).astype(np.int64).T
        return row * PARTS[0] + column

    def _scores_of(self, system: _System, parts: Tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        """(parts, N) gradients of what was seen in each part of the image."""
        scores = np.zeros((PARTS[0] * PARTS[1], self._size))
        sighting_scores(system.whitened, group=parts[0], host_group=parts[1], scores=scores)
        return scores

    def _shifted(self, system: _System, state: DriveState, noise: Noise, shift: np.ndarray) -> _System:
        """The system with residuals that a shift (2,) of all measured pixels makes."""
        residual = -self._whitening(state, noise)[1] @ shift
        pull = np.zeros((len(self._first_idepth), 3))
        pull[:, :2] = -system.whitened.own[:, :2, :2] @ shift
        return system._replace(whitened=system.whitened._replace(residual=residual, pull=pull))

    def _descend(self, state: DriveState, noise: Noise) -> DriveState:
        damping, cost = FIRST_DAMPING, self._cost(state, noise)
        system = self._system(state, noise)
        for _ in range(STEPS):
            moved = self._moved(state, system, damping)
            moved_cost = math.inf if moved is None else self._cost(moved, noise)
            if moved is None or not moved_cost < cost:
                damping *= 30.0
                continue
            decrease, cost, state, damping = cost - moved_cost, moved_cost, moved, 0.1 * damping
            if decrease < SMALL:
                break
            system = self._system(state, noise)
        return state

    def _moved(self, state: DriveState, system: _System, damping: float) -> Optional[DriveState]:
        """The state after one step; None if that is no state."""
        H = system.H.copy()
        diagonal = np.arange(self._size)
        H[diagonal, diagonal] *= 1.0 + damping
        gradient = system.scores.sum(axis=0)
        gradient[:OF_DRIVE] += self.prior.information @ self.prior.deviation(state)
        try:
            step = -cho_solve(cho_factor(H, overwrite_a=True), gradient)
            points = point_steps(system.whitened, step=step)
            return state.moved(step[:OF_DRIVE], step[OF_DRIVE:].reshape(-1, OF_KEYFRAME), points)
        except (ValueError, np.linalg.LinAlgError):
            return None

    def _cost(self, state: DriveState, noise: Noise) -> float:
        deviation = self.prior.deviation(state)
        floor = floor_terms(state, noise.floor, OF_DRIVE).residual
        of_known = 0.5 * float(np.square(floor).sum() + deviation @ self.prior.information @ deviation)
        of_images = self._whitening(state, noise)[2] + self._points_alone(state, noise)[2]
        return of_known + of_images + self._wheel_weights(state, noise)[1]

    def _system(self, state: DriveState, noise: Noise) -> _System:
        H = np.zeros((self._size, self._size))
        scores = np.zeros((int(self._cluster.max()) + 1, self._size))
        residual, roots, _ = self._whitening(state, noise)
        own, pull, _ = self._points_alone(state, noise)
        changes = derivatives(state, self.tracks)
        equations = Equations(
            self.tracks.first,
            self.tracks.host,
            self.tracks.target,
            OF_DRIVE,
            roots @ changes.of_camera,
            roots @ changes.of_host,
            roots @ changes.of_target,
            roots @ changes.of_point,
            residual,
            own,
            pull,
        )
        add_sightings(equations, cluster=self._cluster[self.tracks.host], H=H, scores=scores)
        add_terms(floor_terms(state, noise.floor, OF_DRIVE), H, scores, self._cluster)
        weights, _ = self._wheel_weights(state, noise)
        add_terms(self.wheels.terms(state, noise.wheels, weights, OF_DRIVE), H, scores, self._cluster)
        H[:OF_DRIVE, :OF_DRIVE] += self.prior.information
        poses = np.arange(OF_DRIVE, self._size)
        H[poses, poses] += WEAK
        for keyframe in self._held:
            at = OF_DRIVE + OF_KEYFRAME * keyframe + np.array([0, 1, 5])
            H[at, at] += GAUGE
        return _System(H, scores, equations)

    def _whitening(self, state: DriveState, noise: Noise) -> Tuple[np.ndarray, np.ndarray, float]:
        """Whitened residuals (M, 2), matrices (M, 2, 2) that whiten and weight, and the cost."""
        difference, ahead = residuals(state, self.tracks)
        whitened = np.einsum("nij,nj->ni", self._root, difference) / noise.sightings
        square = np.where(ahead, np.square(whitened).sum(axis=1), 1e4)
        roots = np.sqrt((FREEDOM + 2.0) / (FREEDOM + square)) * ahead
        cost = 0.5 * (FREEDOM + 2.0) * float(np.log1p(square / FREEDOM).sum())
        return whitened * roots[:, None], self._root * (roots / noise.sightings)[:, None, None], cost

    def _points_alone(self, state: DriveState, noise: Noise) -> Tuple[np.ndarray, np.ndarray, float]:
        """Information (P, 3, 3) and gradient (P, 3) of each point's own pixel and depth, and their cost."""
        own = np.zeros((len(self._first_idepth), 3, 3))
        own[:, :2, :2] = self._host_information / noise.sightings**2
        own[:, 2, 2] = 1.0 / np.square(IDEPTH_SLACK * self._first_idepth)
        beside = np.column_stack([state.pixel - self.tracks.host_pixel, state.idepth - self._first_idepth])
        pull = np.einsum("nij,nj->ni", own, beside)
        return own, pull, 0.5 * float((pull * beside).sum())

    def _wheel_weights(self, state: DriveState, noise: Noise) -> Tuple[np.ndarray, float]:
        square = np.square(self.wheels.residuals(state) / noise.wheels).sum(axis=1)
        weights = (FREEDOM + 3.0) / (FREEDOM + square) * self.used
        return weights, 0.5 * (FREEDOM + 3.0) * float((np.log1p(square / FREEDOM) * self.used).sum())

    def _noise(self, state: DriveState, noise: Noise) -> Noise:
        """The noise that the residuals show; that of the floor with the uncertainty of the poses (EM)."""
        system = self._system(state, noise)
        inverse = np.linalg.inv(system.H)
        floor = floor_terms(state, np.ones(3), OF_DRIVE)
        blocks = inverse[floor.unknowns[:, :, None], floor.unknowns[:, None, :]]
        unsure = np.einsum("nki,nij,nkj->k", floor.derivative, blocks, floor.derivative) / len(blocks)
        rough = np.sqrt(np.mean(np.square(roughness(state.T_world_base)), axis=0) + unsure)
        of_wheels = self.wheels.residuals(state)[self.used]
        scatter = median_scatter(of_wheels, axis=0)
        difference, ahead = residuals(state, self.tracks)
        whitened = np.einsum("nij,nj->ni", self._root, difference)[ahead]
        # of two degrees of freedom, half of the squares are below 2 ln 2
        factor = np.sqrt(np.median(np.square(whitened).sum(axis=1)) / (2.0 * np.log(2.0)))
        sightings, points = len(self.tracks.target), len(self.tracks.host)
        factor /= np.sqrt((2 * sightings - points) / (2 * sightings + 2 * points))  # each point takes three of them
        return Noise(np.maximum(rough, LEAST_FLOOR), np.maximum(scatter, LEAST_WHEELS), float(factor))


def _variance_of_sum(scores: np.ndarray, lags: int) -> np.ndarray:
    """Variance of the sum of rows (G, n) that are related to so many neighbours (Newey and West, 1987), (n,)."""
    count = len(scores)
    lags = min(lags, count - 2)
    result = np.square(scores).sum(axis=0)
    for lag in range(1, lags + 1):
        related = 2.0 * (scores[lag:] * scores[:-lag]).sum(axis=0)
        result = result + (1.0 - lag / (lags + 1.0)) * related
    return np.maximum(result, 0.0) * count / max(count - 1 - lags, 1)


def _softened(information: np.ndarray) -> np.ndarray:
    """Information (N, 2, 2) with MODEL_PX added to the noise: (I^-1 + s^2)^-1 = (1 + s^2 I)^-1 I."""
    return np.linalg.solve(np.eye(2) + MODEL_PX**2 * information, information)


def _roots(information: np.ndarray) -> np.ndarray:
    """(N, 2, 2) whose transpose times itself is the softened information."""
    values, vectors = np.linalg.eigh(_softened(information))
    return np.sqrt(np.maximum(values, 0.0))[:, :, None] * np.swapaxes(vectors, 1, 2)


def first_noise() -> Noise:
    """Before anything is known of it."""
    return Noise(FIRST_FLOOR, FIRST_WHEELS, 1.0)
