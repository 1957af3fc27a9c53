# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.evaluation.errors import (
    Statistics,
    body_rotation_deg,
    distance_travelled_m,
    position_errors,
    relative_errors,
    rotation_errors,
)


def straight(count=101, step_m=0.125):  # exact in binary, so that sums of steps are, too
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, 0, 3] = step_m * np.arange(count)
    return poses


def turned(poses, rotvec):
    """The same positions; every orientation turned in the world."""
    result = poses.copy()
    result[:, :3, :3] = Rotation.from_rotvec(rotvec).as_matrix() @ poses[:, :3, :3]
    return result


def test_statistics():
    statistics = Statistics.of(np.array([3.0, -4.0, 0.0, 0.0]))
    assert statistics == Statistics(rmse=2.5, mean=1.75, median=1.5, max=4.0)


def test_position_errors_in_space_and_in_the_plane():
    reference = straight(3)
    aligned = reference.copy()
    aligned[:, :3, 3] += [3.0, 4.0, 12.0]
    assert np.allclose(position_errors(aligned, reference, planar=False), 13.0)
    assert np.allclose(position_errors(aligned, reference, planar=True), 5.0)


@pytest.mark.parametrize("angle", [1e-7, 0.3, 3.0])
def test_rotation_errors_are_angles(angle):
    reference = turned(straight(4), [0.4, -0.8, 1.1])
    axis = np.array([1.0, 2.0, -2.0]) / 3.0
    errors_deg = rotation_errors(turned(reference, angle * axis), reference, planar=False)
    assert np.allclose(errors_deg, np.degrees(angle), rtol=1e-6)


def test_planar_rotation_errors_are_of_yaw():
    reference = turned(straight(4), [0.4, -0.8, 1.1])
    errors_deg = rotation_errors(turned(reference, [0.0, 0.0, -0.2]), reference, planar=True)
    assert np.allclose(errors_deg, np.degrees(0.2))
    assert np.allclose(rotation_errors(turned(reference, [0.01, 0.02, 0.0]), reference, planar=True), 0.0, atol=1e-2)


def test_distance_travelled():
    poses = straight(3, 2.0)
    poses[2, 2, 3] = 1.5
    assert distance_travelled_m(poses).tolist() == [0.0, 2.0, 4.5]
    assert distance_travelled_m(poses, planar=True).tolist() == [0.0, 2.0, 4.0]


def test_relative_errors_of_a_scale_drift():
    reference = straight()
    aligned = reference.copy()
    aligned[:, 0, 3] *= 1.02
    (errors,) = relative_errors(aligned, reference, [2.0], planar=False)
    assert errors.count == 85
    assert errors.translation_m.mean == pytest.approx(0.04)
    assert errors.translation_percent.max == pytest.approx(2.0)
    assert errors.yaw_deg_per_m.max == pytest.approx(0.0, abs=1e-12)


def test_relative_errors_of_a_heading_drift():
    reference = straight()
    drift_deg_per_m = 0.5
    aligned = reference.copy()
    yaw = np.radians(drift_deg_per_m * reference[:, 0, 3])
    aligned[:, :3, :3] = Rotation.from_rotvec(np.outer(yaw, [0.0, 0.0, 1.0])).as_matrix()
    (errors,) = relative_errors(aligned, reference, [4.0], planar=False)
    assert errors.yaw_deg_per_m.mean == pytest.approx(drift_deg_per_m)
    assert errors.rotation_deg_per_m.mean == pytest.approx(drift_deg_per_m)
    # The positions are right, but seen from a first pose that looks elsewhere they lie 4 m times the angle off.
    (from_a_turned_start,) = relative_errors(turned(reference, [0.0, 0.0, 0.01]), reference, [4.0], planar=False)
    assert from_a_turned_start.translation_m.mean == pytest.approx(2.0 * 4.0 * np.sin(0.005))


def test_relative_errors_do_not_see_where_the_world_is():
    rng = np.random.default_rng(2)
    reference = turned(straight(), [0.1, 0.2, 0.3])
    aligned = reference.copy()
    aligned[:, :3, 3] += rng.normal(scale=0.01, size=(len(reference), 3))
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec([0.5, 0.4, -1.0]).as_matrix(), [7.0, 8.0, 9.0]
    (here,) = relative_errors(aligned, reference, [3.0], planar=False)
    (there,) = relative_errors(T @ aligned, reference, [3.0], planar=False)
    assert there.translation_m.rmse == pytest.approx(here.translation_m.rmse)


def test_lengths_that_the_path_does_not_hold_are_left_out():
    results = relative_errors(straight(), straight(), [1.0, 12.45, 100.0], planar=False)
    assert [(errors.length_m, errors.count) for errors in results] == [(1.0, 93), (12.45, 1)]


def test_sub_trajectories_across_a_gap_are_left_out():
    reference = straight()
    reference[50:, 0, 3] += 5.0
    (errors,) = relative_errors(reference, reference, [1.0], planar=False)
    assert errors.count == (50 - 8) + (51 - 8)


@pytest.mark.parametrize("angle", [0.0, 0.5, 3.0])
def test_another_body_is_turned_by_the_same_all_the_way(angle):
    reference = straight()
    reference[:, :3, :3] = Rotation.from_rotvec(np.outer(np.linspace(0.0, 9.0, 101), [0.0, 0.0, 1.0])).as_matrix()
    other = reference.copy()
    other[:, :3, :3] = reference[:, :3, :3] @ Rotation.from_rotvec([0.0, angle, 0.0]).as_matrix()
    assert body_rotation_deg(other, reference) == pytest.approx(np.degrees(angle), abs=1e-5)


def test_a_heading_that_drifts_is_no_other_body():
    aligned = straight()
    aligned[:, :3, :3] = Rotation.from_rotvec(np.outer(np.linspace(0.0, 1.0, 101), [0.0, 0.0, 1.0])).as_matrix()
    assert body_rotation_deg(aligned, straight()) == 0.0
