# SPDX-License-Identifier: BSD-3-Clause
"""Results of the odometry for a recording, compared with the ground truth."""

from collections import defaultdict
from typing import Collection, Dict, List, Sequence, Tuple

import numpy as np

from ceiling_dso_ros.dso import OdometryStatus, TrackingState
from ceiling_dso_ros.dso.durations import seconds
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.evaluation.alignment import MIN_PAIRS, AlignmentKind
from ceiling_dso_ros.evaluation.association import interpolate_poses
from ceiling_dso_ros.evaluation.report import TrajectoryEvaluation, evaluate_trajectory
from ceiling_dso_ros.io.stamps import LATEST_NS
from ceiling_dso_ros.io.trajectory import Trajectory
from ceiling_dso_ros.playback.trajectory_recorder import TrajectoryRecorder

PAIRING_S = 0.02  # the truth is interpolated; this only limits how far away its samples may be
MOVING_M_S = 0.05  # a slower camera stands still
SIGMAS = 5.0  # a pose with a larger error, in its standard deviations, is wrong


class TrackedRun:
    """One run.

    Attributes:
        statuses: one of each image, in order.
        lost: how often tracking was lost.
        first_pose: index of the first image with a pose, the number of images when there is none.
    """

    def __init__(self, statuses: Sequence[OdometryStatus], truth: Trajectory, interpolate: bool = True) -> None:
        """Take the true poses of the camera.

        Args:
            statuses: one of each image.
            truth: with its own stamps.
            interpolate: interpolate the truth at the stamps of the images, instead of taking its nearest poses.
        """
        self.statuses = statuses
        self._stamps_ns = np.array([status.stamp_ns for status in statuses], np.int64)
        within = np.clip(self._stamps_ns, truth.stamps_ns[0], truth.stamps_ns[-1])
        self._T_true = interpolate_poses(truth.stamps_ns, truth.matrices(), within)
        self._true = Trajectory.from_matrices(self._stamps_ns, self._T_true) if interpolate else truth
        self._tracking = np.array([status.state is TrackingState.TRACKING for status in statuses])
        self.lost = sum(status.state is TrackingState.LOST for status in statuses)
        self.first_pose = int(np.argmax(self._tracking)) if self._tracking.any() else len(statuses)
        self._live, self._final = self._evaluations()

    def _evaluations(self) -> Tuple[Dict[int, TrajectoryEvaluation], Dict[int, TrajectoryEvaluation]]:
        """Live and final trajectory of each segment, aligned by Sim(3) on its own."""
        recorders: Dict[int, TrajectoryRecorder] = defaultdict(TrajectoryRecorder)
        for status in self.statuses:
            recorders[status.segment].add(status)
        long_enough = {segment: r for segment, r in recorders.items() if len(r.live()) >= MIN_PAIRS}
        return (
            {segment: self._evaluate(recorder.live()) for segment, recorder in long_enough.items()},
            {segment: self._evaluate(recorder.final()) for segment, recorder in long_enough.items()},
        )

    def _evaluate(self, trajectory: Trajectory) -> TrajectoryEvaluation:
        return evaluate_trajectory("", trajectory, self._true, AlignmentKind.SIM3, PAIRING_S)

    @property
    def first_pose_ns(self) -> int:
        """Stamp of the first image with a pose, of the last one when there is none."""
        return int(self._stamps_ns[min(self.first_pose, len(self.statuses) - 1)])

    @property
    def first_pose_s(self) -> float:
        """Seconds from the first image to the first one with a pose, inf when there is none."""
        return seconds(self.first_pose_ns - self._stamps_ns[0]) if self._tracking.any() else np.inf

    @property
    def keyframes(self) -> int:
        """How many there were."""
        return len({keyframe.keyframe_id for status in self.statuses for keyframe in status.keyframes})

    @property
    def final_ate_m(self) -> float:
        """Root mean square of the position errors of all segments, on refined keyframes; inf without poses."""
        return _ate_m(self._final.values())

    @property
    def live_ate_m(self) -> float:
        """The same for the poses as they were known when each image was processed."""
        return _ate_m(self._live.values())

    @property
    def final_ate_percent(self) -> float:
        """final_ate_m as a share of the path of all segments, inf without segments."""
        path_m = sum(evaluation.path_m for evaluation in self._final.values())
        return 100.0 * self.final_ate_m / path_m if path_m > 0 else np.inf

    @property
    def tracked_percent(self) -> float:
        """Share of the images from the first pose on that have one."""
        return 100.0 * float(self._tracking[self.first_pose :].mean()) if self._tracking.any() else 0.0

    def tracking_within(self, start_ns: int, end_ns: int) -> int:
        """Number of images with a pose whose stamps lie in [start_ns, end_ns]."""
        return int(self._tracking[(self._stamps_ns >= start_ns) & (self._stamps_ns <= end_ns)].sum())

    def motion_without_pose_s(self, start_ns: int = LATEST_NS, end_ns: int = 0) -> float:
        """Longest time in motion between two poses, not counted from start_ns to end_ns, the time of an event.

        The time after the last pose counts. The time before the first pose does not, unless there is no pose at all.
        """
        moving = self._moving_s()
        moving[(self._stamps_ns >= start_ns) & (self._stamps_ns <= end_ns)] = 0.0
        begin = self.first_pose if self._tracking.any() else 0
        longest = gap = 0.0
        for tracking, step_s in zip(self._tracking[begin:], moving[begin:]):
            gap = 0.0 if tracking else gap + step_s
            longest = max(longest, gap)
        return longest

    def motion_before_first_pose_s(self) -> float:
        """Time in motion until the first pose."""
        return float(self._moving_s()[: self.first_pose + 1].sum())

    def _moving_s(self) -> np.ndarray:
        """Time since the last image where the camera has moved in it, else 0, (N,)."""
        steps_s = seconds(np.diff(self._stamps_ns, prepend=self._stamps_ns[0]))
        steps_m = np.linalg.norm(np.diff(self._T_true[:, :3, 3], axis=0, prepend=self._T_true[:1, :3, 3]), axis=1)
        return np.where(steps_m > MOVING_M_S * steps_s, steps_s, 0.0)

    def normalised_errors_squared(self) -> np.ndarray:
        """NEES of the poses relative to their keyframes, (N,), nan where there is no covariance; expected is 6.

        The pose relative to the keyframe is what the tracking measures: the error of a keyframe is common to all images
        that refer to it. The unit of length is that of the whole segment.
        """
        nees = np.full(len(self.statuses), np.nan)
        index = {status.stamp_ns: i for i, status in enumerate(self.statuses)}
        stamps_ns = {k.keyframe_id: k.stamp_ns for status in self.statuses for k in status.keyframes}
        for i, status in enumerate(self.statuses):
            if status.is_keyframe or status.segment not in self._final:
                continue
            if status.covariance is None or status.T_world_camera is None or status.T_keyframe_camera is None:
                continue
            T_true = se3.inverse(self._T_true[index[stamps_ns[status.keyframe_id]]]) @ self._T_true[i]
            T_true[:3, 3] /= self._final[status.segment].alignment.scale
            error = se3.log(T_true @ se3.inverse(status.T_keyframe_camera))
            T_keyframe_world = status.T_keyframe_camera @ se3.inverse(status.T_world_camera)
            move = se3.adjoint(T_keyframe_world)
            nees[i] = error @ np.linalg.solve(move @ status.covariance @ move.T, error)
        return nees

    @property
    def mean_nees(self) -> float:
        """Mean NEES of all poses with a covariance, nan without any; expected is 6."""
        known = self.normalised_errors_squared()
        known = known[np.isfinite(known)]
        return float(known.mean()) if len(known) else np.nan

    def longest_wrong_s(self) -> float:
        """Longest time in which the errors of all poses exceed SIGMAS standard deviations."""
        longest_ns, since_ns = 0, None
        for stamp_ns, nees, tracking in zip(self._stamps_ns, self.normalised_errors_squared(), self._tracking):
            if nees > SIGMAS**2:
                since_ns = stamp_ns if since_ns is None else since_ns
                longest_ns = max(longest_ns, stamp_ns - since_ns)
            elif not (tracking and np.isnan(nees)):  # a keyframe refers to itself, so it has no error
                since_ns = None
        return seconds(longest_ns)

    def losses(self) -> List[str]:
        """Time of each loss, in seconds from the first image, and its message."""
        lost = [status for status in self.statuses if status.state is TrackingState.LOST]
        start_ns = self.statuses[0].stamp_ns
        return [f"{seconds(status.stamp_ns - start_ns):.2f} s: {status.message}" for status in lost]

    def __str__(self) -> str:
        """In one line."""
        return (
            f"{self._tracking.sum()} of {len(self.statuses)} images tracked, the first is {self.first_pose}, "
            f"lost {self.lost} times, ATE final {1e3 * self.final_ate_m:.2f} mm = {self.final_ate_percent:.4f} %, "
            f"live {1e3 * self.live_ate_m:.2f} mm, mean NEES / 6 {self.mean_nees / 6:.2f}"
        )


def _ate_m(evaluations: Collection[TrajectoryEvaluation]) -> float:
    errors_m = [evaluation.position_errors_m for evaluation in evaluations]
    return float(np.sqrt(np.mean(np.concatenate(errors_m) ** 2))) if errors_m else np.inf
