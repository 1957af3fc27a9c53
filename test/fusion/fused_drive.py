# SPDX-License-Identifier: BSD-3-Clause
"""What the fusion makes of a drive that is simulated at the level of trajectories."""

from dataclasses import dataclass

import numpy as np
from simulated_drive import Drive, Truth, simulate_drive

from ceiling_dso_ros.dso.durations import seconds
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.config import FusionConfig, WheelConfig
from ceiling_dso_ros.fusion.estimator import FusionEstimator


@dataclass
class Fused:
    """What the fusion made of a drive."""

    drive: Drive
    estimator: FusionEstimator
    states: list
    wheel_poses: np.ndarray
    scales: list  # (stamp_ns, keyframe id, ScaleState) after each tracked image

    @property
    def stamps(self):
        """(n,) int64 nanoseconds."""
        return np.array([state.stamp_ns for state in self.states], np.int64)

    @property
    def times_s(self):
        """(n,) seconds since the drive began."""
        return seconds(self.stamps - self.drive.stamps[0])

    @property
    def poses(self):
        return np.array([state.pose for state in self.states])

    def truth(self, stamps):
        return np.array([self.drive.pose_at(stamp) for stamp in stamps])

    def ate(self, stamps, poses):
        """Root mean square position error in metres after a rigid alignment in the plane."""
        true, found = self.truth(stamps)[:, :2], np.asarray(poses)[:, :2]
        a, b = true - true.mean(axis=0), found - found.mean(axis=0)
        turn = np.arctan2((b[:, 0] * a[:, 1] - b[:, 1] * a[:, 0]).sum(), (a * b).sum())
        return np.sqrt(((a - b @ planar.rotation(turn).T) ** 2).sum(axis=1).mean())

    def scale_error(self, after_m=np.inf):
        """Relative error of the scale after so many metres of way."""
        way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(self.truth(self.stamps)[:, :2], axis=0).T))])
        until = self.stamps[min(np.searchsorted(way, after_m), len(way) - 1)]
        _, key, scale = [entry for entry in self.scales if entry[0] <= until][-1]
        return scale.value / self.drive.metres_per_unit[key] - 1.0

    def largest_jump(self):
        """Largest difference between published and true motion from one output to the next, metres."""
        true = self.truth(self.stamps)
        return max(
            np.hypot(*(planar.between(a, b) - planar.between(c, d))[:2])
            for a, b, c, d in zip(self.poses, self.poses[1:], true, true[1:])
        )

    def reasons(self, start_s, end_s):
        """All reasons given between two times from the start."""
        return {r for t, s in zip(self.times_s, self.states) if start_s <= t <= end_s for r in s.reasons}


def fuse_drive(drive, config=FusionConfig(), keep_history=True):
    """Play a drive into the fusion, every event at its stamp."""
    estimator = FusionEstimator(drive.robot, config, keep_history)
    states, wheel_poses, scales = [], [], []
    for stamp_ns, is_camera, data in drive.events():
        if is_camera:
            estimator.add_keyframes(data)
            estimator.add_frame(data)
            if data.keyframe_id >= 0 and estimator.scale.segment == data.segment:
                scales.append((stamp_ns, data.keyframe_id, estimator.scale))
        else:
            state = estimator.add_wheel_ticks(stamp_ns, *data)
            if state is not None:
                states.append(state)
                wheel_poses.append(estimator.wheels.total.pose)
    return Fused(drive, estimator, states, np.array(wheel_poses), scales)


def drawn_runs(count, duration_s, losses=()):
    """Errors at the end of runs whose truth is drawn from what the settings say of it.

    Args:
        count, duration_s: how many runs, and how long they are.
        losses: times from start to end when the camera sees nothing.

    Yields:
        (3,) arc from the pose to the true one, its (3, 3) covariance, error of the log-scale, its sigma. Who turns
        wrong and drives on errs along a bow in x and y, which no covariance of x and y describes, but one of arcs does.
    """
    rng, wheels = np.random.default_rng(7), WheelConfig()
    for seed in range(count):
        drawn = Truth(
            ratio=wheels.ratio_sigma * rng.normal(),
            base=wheels.base_sigma * rng.normal(),
            radius=wheels.radius_sigma * rng.normal(),
            wheel_noise=wheels.noise_m_per_sqrt_m,
            unit_m=4.5 * np.exp(0.2 * rng.normal()),
            losses=losses,
        )
        fused = fuse_drive(simulate_drive(("loops", "square")[seed % 2], duration_s, seed, drawn), keep_history=False)
        last = fused.states[-1]
        true = fused.drive.pose_at(last.stamp_ns)
        error = planar.logmap(planar.between(last.pose, true))
        covariance = planar.rotate_covariance(last.covariance, -last.pose[2])
        _, key, scale = fused.scales[-1]
        yield error, covariance, np.log(scale.value / fused.drive.metres_per_unit[key]), scale.sigma
