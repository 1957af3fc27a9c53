# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.lidar.scans import poses
from ceiling_dso_ros.lidar.scans.poses import Path, carried

coordinate = st.floats(-50.0, 50.0)
pose = st.tuples(coordinate, coordinate, st.floats(-3.1, 3.1)).map(np.array)


@given(pose, pose)
def test_many_poses_are_composed_like_one(a, b):
    both, other = np.stack([a, b]), np.stack([b, a])
    np.testing.assert_allclose(poses.compose(both, other)[0], planar.compose(a, b), atol=1e-12)
    np.testing.assert_allclose(poses.between(both, other)[1], planar.between(b, a), atol=1e-12)
    np.testing.assert_allclose(poses.logmap(both)[0], planar.logmap(a), atol=1e-9)
    np.testing.assert_allclose(poses.expmap(both)[1], planar.expmap(b), atol=1e-9)
    np.testing.assert_allclose(poses.matrices(both)[0], planar.lift(a), atol=1e-12)


@given(pose, st.lists(st.tuples(coordinate, coordinate).map(np.array), min_size=1, max_size=5).map(np.array))
def test_points_are_seen_from_a_pose(a, points):
    np.testing.assert_allclose(poses.transformed(points, a), points @ planar.rotation(a[2]).T + a[:2], atol=1e-12)


def test_a_path_goes_on_arcs_and_stands_before_and_after():
    stamps = np.array([0, 1_000_000_000, 3_000_000_000])
    quarter = np.array([1.0, 1.0, np.pi / 2])
    path = Path(stamps, np.array([[0.0, 0.0, 0.0], quarter, quarter]))
    found = path.at(np.array([-5, 500_000_000, 1_000_000_000, 2_000_000_000, 9_000_000_000]))
    half = [np.sin(np.pi / 4), 1.0 - np.cos(np.pi / 4), np.pi / 4]
    np.testing.assert_allclose(found, [[0, 0, 0], half, quarter, quarter, quarter], atol=1e-12)


@given(st.integers(0, 2**32 - 1))
def test_a_carried_path_reaches_its_poses_and_moves_like_the_other(seed):
    rng = np.random.default_rng(seed)
    fine = np.arange(0, 2_000_000_001, 20_000_000)
    shape = Path(fine, np.column_stack([fine * 1e-9, np.sin(fine * 3e-9), np.cos(fine * 2e-9)]))
    coarse = fine[5::20]
    offset = rng.uniform(-1.0, 1.0, 3)
    moved = poses.compose(np.tile(offset, (len(coarse), 1)), shape.at(coarse))
    path = Path(coarse, moved)
    # where nothing is missing, it is the other path, moved as a whole
    np.testing.assert_allclose(
        carried(path, shape, fine), poses.compose(np.tile(offset, (len(fine), 1)), shape.poses), atol=1e-9
    )
    wrong = Path(coarse, poses.compose(moved, 0.05 * rng.standard_normal((len(coarse), 3))))
    np.testing.assert_allclose(carried(wrong, shape, coarse), wrong.poses, atol=1e-9)
    steps = np.diff(carried(wrong, shape, fine)[:, :2], axis=0)
    assert np.hypot(*steps.T).max() < 0.2, "what is missing is spread over the time between"


def test_a_path_of_one_pose_is_carried_by_the_other():
    shape = Path(np.array([0, 10]), np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))
    one = Path(np.array([5]), np.array([[3.0, 4.0, np.pi / 2]]))
    np.testing.assert_allclose(
        carried(one, shape, np.array([0, 5, 10])),
        [[3.0, 3.5, np.pi / 2], [3.0, 4.0, np.pi / 2], [3.0, 4.5, np.pi / 2]],
    )
