import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.evaluation.association import associate, interpolate_poses


def test_pairs_each_stamp_with_the_nearest_reference():
    reference_s = np.arange(0.0, 1.0, 0.01)
    stamps_s = np.array([0.1004, 0.2496, 0.9])
    index, reference_index = associate(stamps_s, reference_s, 0.005)
    assert index.tolist() == [0, 1, 2]
    assert reference_index.tolist() == [10, 25, 90]


def test_leaves_out_what_is_further_apart_than_tau():
    index, reference_index = associate(np.array([0.0, 1.0, 2.0]), np.array([0.009, 1.011, 2.0]), 0.01)
    assert index.tolist() == [0, 2]
    assert reference_index.tolist() == [0, 2]


def test_one_reference_serves_one_stamp_only():
    index, reference_index = associate(np.array([0.98, 1.01, 1.03]), np.array([0.0, 1.0, 5.0]), 0.1)
    assert index.tolist() == [1]
    assert reference_index.tolist() == [1]


def test_one_stamp_is_paired_with_one_of_many_references():
    index, reference_index = associate(np.array([1.0]), np.array([0.999, 1.0005, 1.002]), 0.01)
    assert index.tolist() == [0]
    assert reference_index.tolist() == [1]


def test_swapping_the_trajectories_swaps_the_pairs():
    rng = np.random.default_rng(1)
    a, b = np.sort(rng.uniform(0, 10, 200)), np.sort(rng.uniform(0, 10, 300))
    in_a, in_b = associate(a, b, 0.02)
    in_b_swapped, in_a_swapped = associate(b, a, 0.02)
    assert len(in_a) > 50
    assert np.array_equal(in_a, in_a_swapped)
    assert np.array_equal(in_b, in_b_swapped)
    assert np.all(np.diff(in_a) > 0)
    assert np.all(np.diff(in_b) > 0)


@pytest.mark.parametrize(("stamps", "reference"), [([], [1.0]), ([1.0], []), ([1.0], [3.0])])
def test_nothing_in_common_gives_no_pairs(stamps, reference):
    index, reference_index = associate(np.array(stamps), np.array(reference), 0.5)
    assert len(index) == len(reference_index) == 0


def test_interpolation_is_exact_for_constant_velocity():
    times_s = np.array([0.0, 1.0, 2.0])
    wanted_s = np.array([0.0, 0.25, 1.5, 2.0])

    def poses_at(t):
        poses = np.tile(np.eye(4), (len(t), 1, 1))
        poses[:, :3, 3] = np.outer(t, [1.0, -2.0, 0.5])
        poses[:, :3, :3] = Rotation.from_rotvec(np.outer(t, [0.2, 0.3, -0.4])).as_matrix()
        return poses

    assert np.allclose(interpolate_poses(times_s, poses_at(times_s), wanted_s), poses_at(wanted_s), atol=1e-12)
