# SPDX-License-Identifier: BSD-3-Clause
"""The measures of the accuracy benchmark, on poses whose errors are known."""

import dataclasses

import numpy as np
import pytest

from ceiling_dso_ros.dso import OdometryStatus, TrackingState
from ceiling_dso_ros.dso.durations import nanoseconds
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.status import KeyframeEstimate
from ceiling_dso_ros.experiments.tracked_run import TrackedRun
from ceiling_dso_ros.io.trajectory import Trajectory

FRAMES, HZ, BEGIN_NS, SCALE = 600, 30.0, 1_732_800_000_123_456_789, 4.0
STANDING = 30  # images before the camera moves
STAMPS_NS = [BEGIN_NS + nanoseconds(k / HZ) for k in range(FRAMES)]
SIGMAS = np.array([2e-4, 1e-4, 3e-4, 1e-4, 2e-4, 5e-5])  # of (translation, rotation), VO units and rad


def true_pose(k):
    """T_world_camera in metres: a bow at 0.9 m/s, after standing."""
    way = max(0, k - STANDING) * 0.03
    T = se3.exp(np.array([0.0, 0.0, 0.0, 0.02 * np.sin(way), 0.01 * np.cos(way), 0.4 * way]))
    T[:3, 3] = [4.0 * np.sin(way / 4.0), 4.0 - 4.0 * np.cos(way / 4.0), 0.05 * np.sin(way)]
    return T


TRUTH = Trajectory.from_matrices(STAMPS_NS, [true_pose(k) for k in range(FRAMES)])


def in_units(T):
    """The true pose as an odometry with another origin, orientation and unit has it."""
    scaled = T.copy()
    scaled[:3, 3] /= SCALE
    return se3.exp(np.array([0.5, -1.0, 0.2, 0.3, -0.4, 2.0])) @ scaled


def status(k, error, claimed):
    """A keyframe every tenth image, exact; the others err by `error` from it, left-multiplied in the keyframe."""
    key = k - k % 10
    T_world_key = in_units(true_pose(key))
    stated = se3.exp(error) @ se3.inverse(T_world_key) @ in_units(true_pose(k)) if k > key else np.eye(4)
    move = se3.adjoint(T_world_key)
    return OdometryStatus(
        STAMPS_NS[k],
        TrackingState.TRACKING,
        0,
        T_world_camera=T_world_key @ stated,
        covariance=move @ np.diag(claimed**2) @ move.T,
        is_keyframe=k == key,
        keyframe_id=key // 10,
        T_keyframe_camera=stated,
        keyframes=(KeyframeEstimate(key // 10, STAMPS_NS[key], 0, T_world_key, (0.0, 0.0), False),) if k == key else (),
    )


def statuses(claimed=SIGMAS):
    rng = np.random.default_rng(1)
    return [status(k, SIGMAS * rng.normal(size=6), claimed) for k in range(FRAMES)]


def without_pose(status, state=TrackingState.LOST, message="too dark"):
    return OdometryStatus(status.stamp_ns, state, status.segment, message=message)


def test_exact_poses_have_no_error():
    run = TrackedRun([status(k, np.zeros(6), SIGMAS) for k in range(FRAMES)], TRUTH)
    assert run.final_ate_m < 1e-6
    assert run.live_ate_m < 1e-6
    assert (run.lost, run.first_pose, run.tracked_percent) == (0, 0, 100.0)


def test_error_is_that_of_the_positions_in_metres():
    run = TrackedRun(statuses(), TRUTH)
    expected_m = SCALE * np.linalg.norm(SIGMAS[:3])  # rotations move a camera near its keyframe by little
    assert run.final_ate_m == pytest.approx(expected_m, rel=0.15)
    assert run.final_ate_percent == pytest.approx(100.0 * run.final_ate_m / 17.1, rel=0.02)


@pytest.mark.long
@pytest.mark.parametrize(("claim", "factor"), [(1.0, 1.0), (0.25, 16.0), (2.0, 0.25)])
def test_normalised_errors_tell_a_wrong_covariance(claim, factor):
    run = TrackedRun(statuses(claim * SIGMAS), TRUTH)
    assert np.isnan(run.normalised_errors_squared()[::10]).all()
    assert run.mean_nees == pytest.approx(6.0 * factor, rel=0.15)


@pytest.mark.long
def test_a_wrong_pose_counts_from_its_first_to_its_last_image():
    run = statuses()
    assert TrackedRun(run, TRUTH).longest_wrong_s() < 0.1
    for k in range(300, 345):
        run[k] = status(k, 20.0 * SIGMAS, SIGMAS)
    assert TrackedRun(run, TRUTH).longest_wrong_s() == pytest.approx(43 / HZ, abs=1e-3)  # the first is a keyframe
    for k in range(321, 324):
        run[k] = without_pose(run[k])  # what is not reported is not wrong
    assert TrackedRun(run, TRUTH).longest_wrong_s() == pytest.approx(20 / HZ, abs=1e-3)


def test_losses_and_the_motion_without_a_pose():
    run = statuses()
    for k in range(50):
        run[k] = without_pose(run[k], TrackingState.INITIALIZING)
    for k in range(400, 490):
        run[k] = without_pose(run[k], TrackingState.LOST if k == 400 else TrackingState.INITIALIZING)
    result = TrackedRun(run, TRUTH)
    assert result.lost == 1
    assert result.losses() == ["13.33 s: too dark"]
    assert result.first_pose == 50
    assert result.motion_before_first_pose_s() == pytest.approx((50 - STANDING) / HZ, abs=1e-3)
    assert result.motion_without_pose_s() == pytest.approx(90 / HZ, abs=1e-3)
    event = STAMPS_NS[395], STAMPS_NS[450]
    assert result.motion_without_pose_s(*event) == pytest.approx(39 / HZ, abs=1e-3)
    assert result.tracking_within(*event) == 5


def test_what_is_lost_in_the_end_counts():
    run = statuses()
    run[-60:] = [without_pose(s) for s in run[-60:]]
    assert TrackedRun(run, TRUTH).motion_without_pose_s() == pytest.approx(60 / HZ, abs=1e-3)


def test_segments_are_aligned_one_by_one():
    move = se3.exp(np.array([3.0, 2.0, 1.0, 0.1, 0.2, 0.3]))
    run = statuses()
    for k in range(400, FRAMES):
        status = run[k]
        keyframes = tuple(
            dataclasses.replace(e, segment=1, T_world_camera=move @ e.T_world_camera) for e in status.keyframes
        )
        run[k] = dataclasses.replace(
            status, segment=1, T_world_camera=move @ status.T_world_camera, keyframes=keyframes
        )
    assert TrackedRun(run, TRUTH).final_ate_m == pytest.approx(TrackedRun(statuses(), TRUTH).final_ate_m, rel=0.1)


def test_a_run_without_any_pose():
    run = TrackedRun([without_pose(s, TrackingState.INITIALIZING) for s in statuses()], TRUTH)
    assert (run.first_pose, run.tracked_percent, run.final_ate_m) == (FRAMES, 0.0, np.inf)
    assert run.motion_without_pose_s() == pytest.approx((FRAMES - STANDING) / HZ, abs=0.1)
    assert run.longest_wrong_s() == 0.0
    assert np.isnan(run.mean_nees)
    assert str(run)
