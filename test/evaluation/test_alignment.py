# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.evaluation.alignment import AlignmentError, AlignmentKind, align

IN_SPACE = Rotation.from_rotvec([0.7, -1.9, 0.4]).as_matrix()
IN_PLANE = Rotation.from_rotvec([0.0, 0.0, 2.3]).as_matrix()


def positions(count=50, seed=3):
    return np.random.default_rng(seed).normal(size=(count, 3)) * [4.0, 2.0, 0.5]


def poses_at(points, seed=4):
    poses = np.tile(np.eye(4), (len(points), 1, 1))
    poses[:, :3, :3] = Rotation.random(len(points), random_state=seed).as_matrix()
    poses[:, :3, 3] = points
    return poses


@pytest.mark.parametrize(
    ("kind", "R", "t_m", "scale"),
    [
        (AlignmentKind.SIM3, IN_SPACE, [3.0, -5.0, 1.0], 4.2),
        (AlignmentKind.SE3, IN_SPACE, [3.0, -5.0, 1.0], 1.0),
        (AlignmentKind.SE2, IN_PLANE, [3.0, -5.0, 0.0], 1.0),
        (AlignmentKind.SIM2, IN_PLANE, [3.0, -5.0, 0.0], 0.3),
    ],
)
def test_recovers_a_known_transformation(kind, R, t_m, scale):
    estimate = positions()
    alignment = align(estimate, scale * estimate @ R.T + t_m, kind)
    assert np.allclose(alignment.R, R, atol=1e-12)
    assert np.allclose(alignment.t_m, t_m, atol=1e-12)
    assert alignment.scale == pytest.approx(scale, abs=1e-12)
    assert alignment.rotation_determined


def test_applies_to_whole_poses():
    estimate = poses_at(positions())
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = IN_SPACE, [1.0, 2.0, 3.0]
    reference = T @ estimate
    alignment = align(estimate[:, :3, 3], reference[:, :3, 3], AlignmentKind.SE3)
    assert np.allclose(alignment.apply(estimate), reference, atol=1e-12)


def test_is_the_least_squares_solution():
    rng = np.random.default_rng(5)
    estimate = positions()
    reference = 2.0 * estimate @ IN_SPACE.T + rng.normal(scale=0.3, size=estimate.shape)
    alignment = align(estimate, reference, AlignmentKind.SIM3)

    def cost(R, t_m, scale):
        return np.sum((reference - scale * estimate @ R.T - t_m) ** 2)

    best = cost(alignment.R, alignment.t_m, alignment.scale)
    for _ in range(50):
        R = Rotation.from_rotvec(rng.normal(scale=1e-3, size=3)).as_matrix() @ alignment.R
        t_m = alignment.t_m + rng.normal(scale=1e-3, size=3)
        assert cost(R, t_m, alignment.scale + rng.normal(scale=1e-3)) > best


def test_a_mirror_image_still_gives_a_rotation():
    estimate = positions()
    alignment = align(estimate, estimate * [1.0, 1.0, -1.0], AlignmentKind.SIM3)
    assert np.linalg.det(alignment.R) == pytest.approx(1.0)


def test_motion_in_a_plane_determines_the_rotation_in_space():
    estimate = positions() * [1.0, 1.0, 0.0]
    alignment = align(estimate, estimate @ IN_SPACE.T, AlignmentKind.SIM3)
    assert np.allclose(alignment.R, IN_SPACE, atol=1e-12)
    assert alignment.rotation_determined


def test_a_straight_line_aligns_positions_but_not_the_turn_about_it():
    estimate = np.outer(np.linspace(0.0, 5.0, 20), [1.0, 0.5, -0.2])
    reference = 3.0 * estimate @ IN_SPACE.T + [1.0, 1.0, 1.0]
    alignment = align(estimate, reference, AlignmentKind.SIM3)
    assert not alignment.rotation_determined
    assert np.linalg.det(alignment.R) == pytest.approx(1.0)
    assert np.allclose(alignment.apply(poses_at(estimate))[:, :3, 3], reference, atol=1e-9)
    assert align(estimate, estimate @ IN_PLANE.T, AlignmentKind.SE2).rotation_determined


def test_fewer_than_three_pairs_is_an_error():
    with pytest.raises(AlignmentError, match="2 pairs of poses, at least 3"):
        align(positions(2), positions(2), AlignmentKind.SE3)


@pytest.mark.parametrize(("standing", "kind"), [("estimate", AlignmentKind.SIM3), ("reference", AlignmentKind.SIM2)])
def test_no_scale_without_motion(standing, kind):
    points = {"estimate": positions(), "reference": positions()}
    points[standing] = np.full((50, 3), 0.1)
    with pytest.raises(AlignmentError, match=f"the {standing} does not move"):
        align(points["estimate"], points["reference"], kind)


def test_standing_still_leaves_a_metric_rotation_open():
    alignment = align(np.full((5, 3), 0.1), np.full((5, 3), 2.0), AlignmentKind.SE3)
    assert not alignment.rotation_determined
    assert np.allclose(alignment.R @ np.full(3, 0.1) + alignment.t_m, 2.0)
