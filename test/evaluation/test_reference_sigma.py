# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.evaluation.alignment import AlignmentKind
from ceiling_dso_ros.evaluation.reference_sigma import ReferencePart, ReferenceSigma, ranking, reference_part
from ceiling_dso_ros.evaluation.report import evaluate_trajectory
from ceiling_dso_ros.io.pose_covariances import PoseCovariances
from ceiling_dso_ros.io.trajectory import Trajectory

STAMPS = np.arange(200, dtype=np.int64) * 10**8


def circle(noise_m, seed=0):
    angle = np.linspace(0.0, 2 * np.pi, 200)
    T = np.tile(np.eye(4), (200, 1, 1))
    T[:, :2, 3] = 3.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    T[:, :2, 3] += noise_m * np.random.default_rng(seed).standard_normal((200, 2))
    return Trajectory.from_matrices(STAMPS, T)


def evaluated(noise_m):
    return evaluate_trajectory("fused", circle(noise_m), circle(0.0), AlignmentKind.SE2, 0.01)


def test_sigmas_come_from_covariances_and_are_interpolated():
    matrices = np.array([np.diag([9e-6, 16e-6, 4e-6]), np.diag([36e-6, 64e-6, 4e-6])])
    position, yaw = ReferenceSigma.of(PoseCovariances(np.array([0, 10**9]), matrices)).at(np.array([0, 5 * 10**8]))
    np.testing.assert_allclose(position, [0.005, 0.0075])
    np.testing.assert_allclose(yaw, [0.002, 0.002])
    np.testing.assert_allclose(ReferenceSigma.constant(0.01).at(np.array([5, 7]))[0], [0.01, 0.01])


def test_errors_that_may_be_those_of_the_reference_are_marked():
    part = reference_part(evaluated(0.01), ReferenceSigma.constant(0.001))
    assert part.position_m == pytest.approx(0.001)
    assert all(each.good_enough for each in part.relative)
    assert part.relative[0].translation_m == pytest.approx(0.001 * np.sqrt(2.0))
    assert not any("*" in line for line in part.describe())
    doubtful = reference_part(evaluated(0.01), ReferenceSigma.constant(0.01))
    assert not any(each.good_enough for each in doubtful.relative)
    assert sum("* over" in line for line in doubtful.describe()) == len(doubtful.relative) == 5
    assert "the reference's own uncertainty 0.0100 m" in doubtful.describe()[0]


def test_an_uncertain_yaw_counts_the_more_the_longer_a_part_is():
    matrices = np.tile(np.diag([1e-12, 1e-12, 1e-4]), (2, 1, 1))
    part = reference_part(evaluated(0.01), ReferenceSigma.of(PoseCovariances(STAMPS[[0, -1]], matrices)))
    np.testing.assert_allclose([r.translation_m / r.length_m for r in part.relative], 0.01, rtol=1e-2)


def part_of(name, rmse_m, position_m):
    return ReferencePart(name, rmse_m, position_m, 0.0, ())


def test_what_the_reference_does_not_tell_apart_is_not_ranked():
    parts = [part_of("wheel", 0.2, 0.005), part_of("fused", 0.010, 0.005), part_of("smoothed", 0.007, 0.005)]
    assert ranking(parts) == [["smoothed", "fused"], ["wheel"]]
    sure = [part_of(part.name, part.rmse_m, 0.001) for part in parts]
    assert ranking(sure) == [["smoothed"], ["fused"], ["wheel"]]
    assert ranking([]) == []
