# SPDX-License-Identifier: BSD-3-Clause
"""Random smooth drives at today's epoch, of which the reference is stamped late or early."""

import os
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.evaluation.time_offset import TimeOffset, estimate_time_offset
from ceiling_dso_ros.io.trajectory import Trajectory, read_tum

DATA = Path(os.environ.get("CEILING_DSO_DATA", Path(__file__).parents[2].parent / "shared" / "data"))
BEGIN_NS = 1_732_800_000_123_456_789
STEP_S = 0.005
WORLD = Rotation.from_rotvec([0.3, -1.0, 0.2])
MOUNT = Rotation.from_rotvec([0.1, 0.0, 1.5])


def drive(seconds=60.0, seed=0, constant=False):
    """x, y, yaw every STEP_S of a robot that changes speed and yaw rate every 1.5 s, or never."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, STEP_S)
    knots = np.arange(0.0, seconds + 3.0, 1.5)
    v, w = (np.interp(t, knots, rng.uniform(*limits, len(knots))) for limits in ((0.0, 0.8), (-0.8, 0.8)))
    if constant:
        v, w = np.full(len(t), 0.5), np.zeros(len(t))
    kernel = np.hanning(81) / np.hanning(81).sum()
    v, w = np.convolve(v, kernel, "same"), np.convolve(w, kernel, "same")
    yaw = np.cumsum(w) * STEP_S
    return np.column_stack([np.cumsum(v * np.cos(yaw)) * STEP_S, np.cumsum(v * np.sin(yaw)) * STEP_S, yaw])


def seen(poses, rate_hz, late_s=0.0, noise=0.0, scale=1.0, seed=0):
    """What is recorded of it at a rate, with noise in m and rad, in another world, frame and unit."""
    rng = np.random.default_rng([seed, 1])
    times_s = np.arange(1.0 + rng.uniform(0.0, 1.0 / rate_hz), len(poses) * STEP_S - 1.0, 1.0 / rate_hz)
    x, y, yaw = (np.interp(times_s, STEP_S * np.arange(len(poses)), column) for column in poses.T)
    xyz = np.column_stack([x, y, 0.0 * x]) + noise * rng.normal(size=(len(x), 3))
    turns = Rotation.from_rotvec(np.column_stack([0.0 * x, 0.0 * x, yaw]) + noise * rng.normal(size=(len(x), 3)))
    stamps_ns = BEGIN_NS + np.rint(1e9 * (times_s + late_s)).astype(np.int64)
    return Trajectory(stamps_ns, scale * WORLD.apply(xyz), (WORLD * turns * MOUNT).as_quat())


@pytest.mark.parametrize("late_s", [-0.05, 0.0, 0.05, 0.4])
@pytest.mark.parametrize(("rate_hz", "reference_hz"), [(30, 200), (15, 100), (30, 10), (50, 50)])
def test_an_offset_is_found_at_any_rates(late_s, rate_hz, reference_hz):
    poses = drive()
    found = estimate_time_offset(
        seen(poses, rate_hz, scale=0.3, noise=5e-4), seen(poses, reference_hz, late_s, 1e-3, 5)
    )
    assert not found.unknown
    assert found.value_s == pytest.approx(late_s, abs=0.003)
    assert found.sigma_s < 0.003
    assert found.significant == (late_s != 0.0)


def test_the_standard_deviation_is_about_the_error():
    """Also with much noise, and where the reference has the same rate and thus always the same phase."""
    deviations = []
    for seed in range(24):
        poses, late_s = drive(40.0, seed), (seed % 5 - 2) * 0.02
        found = estimate_time_offset(
            seen(poses, 30, 0.0, 0.005, 0.3, seed), seen(poses, 30, late_s, 0.005, 1.0, seed + 100)
        )
        deviations.append((found.value_s - late_s) / found.sigma_s)
    assert 0.6 < np.sqrt(np.mean(np.square(deviations))) < 1.5


@pytest.mark.parametrize("noise", [1e-4, 2e-3, 2e-2])
@pytest.mark.parametrize("seed", range(3))
def test_a_straight_drive_at_constant_speed_tells_nothing(noise, seed):
    poses = drive(constant=True)
    found = estimate_time_offset(seen(poses, 30, 0.0, noise, 1.0, seed), seen(poses, 100, 0.05, 1e-3, 1.0, seed + 9))
    assert found.unknown
    assert not found.significant
    assert found.numbers() == {"unknown": found.unknown}


def test_lost_tracking_gaps_and_a_jump_do_little_harm():
    poses = drive()
    whole = seen(poses, 30, noise=5e-4)
    kept = np.ones(len(whole), bool)
    kept[300:390] = kept[900:960] = False
    positions = whole.positions.copy()
    positions[1200:] += 25.0
    broken = Trajectory(whole.stamps_ns[kept], positions[kept], whole.quaternions_xyzw[kept])
    found = estimate_time_offset(broken, seen(poses, 100, 0.05, 1e-3))
    assert found.value_s == pytest.approx(0.05, abs=0.003)
    assert found.sigma_s < 0.003


def test_a_stamp_of_another_time_costs_no_memory():
    poses = drive()
    whole = seen(poses, 30, noise=5e-4)
    stamps_ns = whole.stamps_ns.copy()
    stamps_ns[0] = 0  # before the clock was set
    found = estimate_time_offset(
        Trajectory(stamps_ns, whole.positions, whole.quaternions_xyzw), seen(poses, 100, 0.05, 1e-3)
    )
    assert found.value_s == pytest.approx(0.05, abs=0.003)


def test_what_cannot_be_found_is_said():
    poses = drive()
    here, late = seen(poses, 30), seen(poses, 100, 3.0)
    assert "larger than 1 s" in estimate_time_offset(here, late).unknown or "are not those" in str(
        estimate_time_offset(here, late)
    )
    assert "no time in common" in estimate_time_offset(here, seen(poses, 100, 1e4)).unknown
    assert "too few poses" in estimate_time_offset(Trajectory.from_matrices([], []), late).unknown
    short = Trajectory(here.stamps_ns[:150], here.positions[:150], here.quaternions_xyzw[:150])
    assert estimate_time_offset(short, seen(poses, 100)).unknown


def test_small_or_uncertain_ones_are_not_significant():
    assert TimeOffset(0.05, 0.001).significant
    assert TimeOffset(-0.05, 0.001).significant
    assert not TimeOffset(0.0015, 1e-5).significant
    assert not TimeOffset(0.05, 0.02).significant
    assert str(TimeOffset(-0.05, 0.0012)) == "-50.0 +- 1.2 ms"


@pytest.mark.parametrize("recording", ["tum_fr1_xyz", "ceiling_loops"])
@pytest.mark.parametrize("late_s", [-0.05, 0.05])
def test_real_trajectories(recording, late_s):
    """A hand-held camera against motion capture, and a robot."""
    folder = DATA / recording
    if not folder.is_dir():
        pytest.skip(f"the recording is missing: {folder}")
    estimate, reference = read_tum(folder / "reference_final.tum"), read_tum(folder / "groundtruth.tum")
    own = estimate_time_offset(estimate, reference)
    found = estimate_time_offset(estimate, reference.shifted(round(late_s * 1e9)))
    assert found.value_s - own.value_s == pytest.approx(late_s, abs=0.001)
    assert abs(own.value_s) < 0.02
    assert found.sigma_s < 0.005
    assert found.significant
