# SPDX-License-Identifier: BSD-3-Clause
"""One run of the fusion over a tracked recording, compared with the ground truth."""

from typing import List, Sequence, Tuple

import numpy as np
from numpy.typing import ArrayLike

from ceiling_dso_ros.dso import OdometryStatus, TrackingState
from ceiling_dso_ros.dso.durations import nanoseconds, seconds
from ceiling_dso_ros.evaluation.alignment import MIN_PAIRS, AlignmentKind, align
from ceiling_dso_ros.evaluation.association import interpolate_poses
from ceiling_dso_ros.evaluation.report import evaluate_trajectory
from ceiling_dso_ros.experiments.tracked_run import SIGMAS
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.state import FusionState, ScaleState
from ceiling_dso_ros.io.recording import Recording
from ceiling_dso_ros.io.trajectory import Trajectory
from ceiling_dso_ros.playback.fusion_playback import FusionPlayback
from ceiling_dso_ros.playback.trajectory_recorder import TrajectoryRecorder


class FusedRun:
    """Plays wheel samples and visual odometry into the fusion.

    Attributes:
        recording: with wheels and the nominal robot.
        playback: the results of the fusion.
        path_m: length of the base's path.
    """

    def __init__(
        self,
        recording: Recording,
        statuses: Sequence[OdometryStatus],
        camera_truth: Trajectory,
        base_truth: Trajectory,
    ) -> None:
        self.recording = recording
        self.playback = FusionPlayback.of(recording)
        self._camera_truth, self._base_truth = camera_truth, base_truth
        camera = TrajectoryRecorder()
        self._scales: List[Tuple[int, ScaleState]] = []
        for status in statuses:
            self.playback.add(status)
            camera.add(status)
            self._scales.append((status.stamp_ns, self.playback.estimator.scale))
        self.playback.finish()
        self._camera = camera.final()
        self._segments = np.array([status.segment for status in statuses if status.state is TrackingState.TRACKING])
        steps_m = np.hypot(*np.diff(base_truth.positions[:, :2], axis=0).T)
        self._way_m = np.concatenate([[0.0], np.cumsum(steps_m)])
        self.path_m = float(self._way_m[-1])

    def ate_m(self, trajectory: Trajectory, kind: AlignmentKind = AlignmentKind.SE2) -> float:
        """Root mean square position error of the base after an alignment, at the stamps of the estimate."""
        return evaluate_trajectory("", trajectory, self._base_truth, kind, 0.05, interpolate=True).ate_m.rmse

    def ate_percent(self, trajectory: Trajectory) -> float:
        """SE(2) error as a share of the path."""
        return 100.0 * self.ate_m(trajectory) / self.path_m

    def scale_error_percent(self, way_m: float, wheels_per_true: float = 1.0) -> float:
        """Error of the scale after a distance, inf where no scale is known.

        The truth is the scale of the Sim(3) that aligns the camera's path in that segment so far (final estimate of the
        odometry) with the true path. Over shorter distances the errors of the odometry hide it.

        Args:
            way_m: distance driven by the base from the start.
            wheels_per_true: distance by the wheels over the true distance; the scale has the same error.
        """
        until_ns = self.stamp_ns(way_m)
        scale = [state for stamp_ns, state in self._scales if stamp_ns <= until_ns][-1]
        stamps_ns = self._camera.stamps_ns
        chosen = (stamps_ns <= until_ns) & (self._segments == scale.segment)
        if not scale.converged or chosen.sum() < MIN_PAIRS:
            return np.inf
        true = interpolate_poses(self._camera_truth.stamps_ns, self._camera_truth.matrices(), stamps_ns[chosen])
        aligned = align(self._camera.positions[chosen], true[:, :3, 3], AlignmentKind.SIM3)
        return 100.0 * abs(scale.value / (aligned.scale * wheels_per_true) - 1.0)

    def wheels_per_true(self) -> float:
        """Total distance by the wheels over the true distance."""
        steps_m = np.hypot(*np.diff(self.playback.wheel().positions[:, :2], axis=0).T)
        return float(steps_m.sum()) / self.path_m

    def way_m(self, stamp_ns: int) -> float:
        """Distance driven by the base until a stamp."""
        return float(np.interp(stamp_ns, self._base_truth.stamps_ns, self._way_m))

    def stamp_ns(self, way_m: float) -> int:
        """When the base has gone so far."""
        index = np.searchsorted(self._way_m, min(max(way_m, 0.0), self.path_m))
        return int(self._base_truth.stamps_ns[index])

    def true_poses(self, stamps_ns: ArrayLike) -> np.ndarray:
        """(n, 3) of the base, seen from where it was at the first wheel sample."""
        origin = _in_plane(self._base_truth, self._base_truth.stamps_ns[:1])[0]
        return np.array([planar.between(origin, pose) for pose in _in_plane(self._base_truth, stamps_ns)])

    def published(self) -> Tuple[np.ndarray, np.ndarray]:
        """Stamps (n,) and poses (n, 3) of all outputs."""
        states = self.playback.states
        return np.array([state.stamp_ns for state in states], np.int64), np.array([state.pose for state in states])

    def normalised_errors_squared(self) -> np.ndarray:
        """NEES of all outputs, (n,); expected is 3."""
        stamps_ns, poses = self.published()
        errors = poses - self.true_poses(stamps_ns)
        errors[:, 2] = [planar.wrap(yaw) for yaw in errors[:, 2]]
        covariances = np.array([state.covariance for state in self.playback.states])
        return np.einsum("ni,ni->n", errors, np.linalg.solve(covariances, errors[:, :, None])[:, :, 0])

    def mean_nees(self) -> float:
        """Its mean over the outputs after the first second, in which the pose has hardly an error."""
        stamps_ns, _ = self.published()
        return float(self.normalised_errors_squared()[stamps_ns >= stamps_ns[0] + nanoseconds(1.0)].mean())

    def longest_wrong_s(self) -> float:
        """Longest time in which the errors of all poses that are called good exceed SIGMAS standard deviations."""
        longest_ns, since_ns = 0, None
        for state, nees in zip(self.playback.states, self.normalised_errors_squared()):
            if state.state is not FusionState.CONVERGED or nees <= SIGMAS**2:
                since_ns = None
                continue
            since_ns = state.stamp_ns if since_ns is None else since_ns
            longest_ns = max(longest_ns, state.stamp_ns - since_ns)
        return seconds(longest_ns)

    def largest_jump_m(self) -> float:
        """Largest difference between the motion from one output to the next and the true motion."""
        stamps_ns, poses = self.published()
        true = self.true_poses(stamps_ns)
        errors = [
            planar.between(planar.between(*true[i : i + 2]), planar.between(*poses[i : i + 2]))[:2]
            for i in range(len(poses) - 1)
        ]
        return float(np.hypot(*np.transpose(errors)).max())

    def end_apart_m(self, other: "FusedRun") -> float:
        """Distance of the last output from that of another run of the same drive."""
        return float(np.hypot(*(self.published()[1][-1] - other.published()[1][-1])[:2]))

    def wheel_drift_m(self, start_ns: int, end_ns: int) -> float:
        """Error of the end position if the wheels' motion replaces the true one between two stamps."""
        before, after = _in_plane(self.playback.wheel(), [start_ns, end_ns])
        true_start, true_end, true_last = self.true_poses([start_ns, end_ns, self._base_truth.stamps_ns[-1]])
        drifted = planar.compose(true_start, planar.between(before, after))
        last = planar.compose(drifted, planar.between(true_end, true_last))
        return float(np.hypot(*(last - true_last)[:2]))


def _in_plane(trajectory: Trajectory, stamps_ns: ArrayLike) -> np.ndarray:
    """(n, 3) x, y, yaw at n stamps."""
    T = interpolate_poses(trajectory.stamps_ns, trajectory.matrices(), np.asarray(stamps_ns, np.int64))
    cos, sin = np.ascontiguousarray(T[:, :2, 0].T)  # or the last bit depends on its place in memory
    return np.column_stack([T[:, :2, 3], np.arctan2(sin, cos)])
