# SPDX-License-Identifier: BSD-3-Clause
import json

import numpy as np
import pytest
from evo.core import metrics, sync
from evo.core.trajectory import PoseTrajectory3D
from evo.main_ape import ape
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.dso.durations import seconds
from ceiling_dso_ros.evaluation.alignment import AlignmentKind
from ceiling_dso_ros.evaluation.report import EvaluationError, evaluate_trajectory, tables
from ceiling_dso_ros.io.trajectory import Trajectory

TAU_S = 0.01
BEGIN_NS = 1_000 * 10**9


def ns(stamps_s):
    return np.rint(np.asarray(stamps_s) * 1e9).astype(np.int64)


def winding(stamps_ns):
    """A body that drives an eight and turns with it."""
    t = seconds(stamps_ns - BEGIN_NS)
    positions = np.stack([4.0 * np.sin(0.5 * t), 2.0 * np.sin(t), 0.3 * np.cos(0.8 * t)], axis=1)
    rotations = Rotation.from_rotvec(np.stack([0.05 * np.sin(t), 0.1 * np.cos(t), 0.6 * t], axis=1))
    return Trajectory(stamps_ns, positions, rotations.as_quat())


def reference():
    return winding(BEGIN_NS + 10_000_000 * np.arange(1500))


def monocular(noise_m=0.02, seed=0):
    """Every third of a second of the same drive, in another world and unit, with jitter in time and noise."""
    rng = np.random.default_rng(seed)
    truth = winding(BEGIN_NS + ns(np.arange(0.0, 15.0, 1 / 30) + rng.uniform(-0.003, 0.003, 450)))
    R = Rotation.from_rotvec([1.0, -0.3, 0.8])
    positions = R.apply(truth.positions + rng.normal(scale=noise_m, size=truth.positions.shape)) / 4.0 + [1.0, 2.0, 3.0]
    wobble = Rotation.from_rotvec(rng.normal(scale=0.01, size=(len(truth), 3)))
    quaternions = (R * wobble * Rotation.from_quat(truth.quaternions_xyzw)).as_quat()
    return Trajectory(truth.stamps_ns, positions, quaternions)


def evo_trajectory(trajectory):
    quaternions_wxyz = np.roll(trajectory.quaternions_xyzw, 1, axis=1)
    return PoseTrajectory3D(trajectory.positions, quaternions_wxyz, seconds(trajectory.stamps_ns))


def evo_ape(estimate, relation, scaled):
    pair = sync.associate_trajectories(evo_trajectory(reference()), evo_trajectory(estimate), max_diff=TAU_S)
    return ape(*pair, pose_relation=relation, align=True, correct_scale=scaled).stats


@pytest.mark.parametrize("kind", [AlignmentKind.SIM3, AlignmentKind.SE3])
def test_absolute_errors_agree_with_evo(kind):
    evaluation = evaluate_trajectory("camera", monocular(), reference(), kind, TAU_S)
    position = evo_ape(monocular(), metrics.PoseRelation.translation_part, kind.scaled)
    rotation = evo_ape(monocular(), metrics.PoseRelation.rotation_angle_deg, kind.scaled)
    numbers = evaluation.numbers()
    for name in ("rmse", "mean", "median", "max"):
        assert numbers["ate_m"][name] == pytest.approx(position[name], abs=1e-9)
        assert numbers["rotation_deg"][name] == pytest.approx(rotation[name], abs=1e-6)


def test_an_exact_estimate_in_another_world_has_no_error_but_that_of_the_stamps():
    truth = reference()
    R = Rotation.from_rotvec([0.1, 2.0, -0.5])
    estimate = Trajectory(
        truth.stamps_ns,
        0.2 * R.apply(truth.positions) + [5.0, 0.0, -1.0],
        (R * Rotation.from_quat(truth.quaternions_xyzw)).as_quat(),
    )
    evaluation = evaluate_trajectory("camera", estimate, truth, AlignmentKind.SIM3, TAU_S)
    assert evaluation.alignment.scale == pytest.approx(5.0)
    assert evaluation.pairs == len(truth)
    assert evaluation.ate_m.max < 1e-9
    assert evaluation.rotation_errors_deg.max() < 1e-5
    assert np.allclose(evaluation.aligned, truth.matrices(), atol=1e-9)
    assert max(errors.translation_percent.max for errors in evaluation.relative) < 1e-6


def test_interpolating_the_reference_takes_the_error_of_the_stamps_away():
    nearest = evaluate_trajectory("camera", monocular(0.0), reference(), AlignmentKind.SIM3, TAU_S)
    interpolated = evaluate_trajectory("camera", monocular(0.0), reference(), AlignmentKind.SIM3, TAU_S, True)
    assert nearest.ate_m.rmse > 2e-3
    assert interpolated.ate_m.rmse < 1e-4


def test_all_poses_are_aligned_also_those_without_a_partner():
    estimate = monocular(0.0)
    late = reference()
    late = Trajectory(late.stamps_ns[500:], late.positions[500:], late.quaternions_xyzw[500:])
    evaluation = evaluate_trajectory("camera", estimate, late, AlignmentKind.SIM3, TAU_S)
    assert evaluation.pairs < evaluation.poses == len(estimate)
    assert np.allclose(evaluation.aligned[:, :3, 3], winding(estimate.stamps_ns).positions, atol=0.02)


def test_planar_kinds_leave_height_out():
    truth = reference()
    raised = Trajectory(truth.stamps_ns, truth.positions + np.array([3.0, 1.0, 7.0]), truth.quaternions_xyzw)
    evaluation = evaluate_trajectory("wheel", raised, truth, AlignmentKind.SE2, TAU_S)
    assert evaluation.ate_m.max < 1e-9
    assert evaluate_trajectory("wheel", raised, truth, AlignmentKind.SE3, TAU_S).ate_m.max < 1e-9


def test_the_rotation_error_of_a_straight_drive_is_unknown():
    stamps_s = np.arange(0.0, 3.0, 0.1)
    line = Trajectory(
        ns(stamps_s), np.outer(stamps_s, [1.0, 0.0, 0.0]), np.tile([0.0, 0.0, 0.0, 1.0], (len(stamps_s), 1))
    )
    evaluation = evaluate_trajectory("camera", line, line, AlignmentKind.SIM3, TAU_S)
    assert evaluation.rotation_errors_deg is None
    assert evaluation.numbers()["rotation_deg"] is None
    assert evaluation.ate_m.rmse < 1e-9
    assert tables([evaluation]).splitlines()[2].endswith("-")


def test_numbers_are_json_and_tables_hold_them():
    evaluation = evaluate_trajectory("camera_final", monocular(), reference(), AlignmentKind.SIM3, TAU_S)
    numbers = json.loads(json.dumps(evaluation.numbers(), allow_nan=False))
    assert numbers["pairs"] == evaluation.pairs
    assert [errors["length_m"] / numbers["path_m"] for errors in numbers["relative"]] == pytest.approx(
        [0.1, 0.2, 0.3, 0.4, 0.5]
    )
    text = tables([evaluation])
    assert f"{numbers['ate_m']['rmse']:.4f}" in text
    assert text.count("camera_final") == 6


def test_no_overlap_says_both_ranges():
    truth = reference()
    later = Trajectory(truth.stamps_ns + 100 * 10**9, truth.positions, truth.quaternions_xyzw)
    with pytest.raises(EvaluationError, match=r"1100\.000 to 1114\.990 s, the reference 1000\.000 to 1014\.990 s"):
        evaluate_trajectory("camera", later, truth, AlignmentKind.SIM3, TAU_S)


def test_stamps_between_each_other_are_told_from_no_overlap():
    truth = reference()
    between = Trajectory(truth.stamps_ns + 5_000_000, truth.positions, truth.quaternions_xyzw)
    with pytest.raises(EvaluationError, match=r"no stamps within 0\.001 s of each other"):
        evaluate_trajectory("camera", between, truth, AlignmentKind.SIM3, 0.001)


@pytest.mark.parametrize("interpolate", [False, True])
@pytest.mark.parametrize("count", [1, 2])
def test_fewer_than_three_pairs_is_an_error(count, interpolate):
    truth = reference()
    few = Trajectory(truth.stamps_ns[:count], truth.positions[:count], truth.quaternions_xyzw[:count])
    for estimate, against in ((few, truth), (truth, few)):
        with pytest.raises(EvaluationError, match=f"{count} pairs of poses, at least 3"):
            evaluate_trajectory("camera", estimate, against, AlignmentKind.SIM3, TAU_S, interpolate)
