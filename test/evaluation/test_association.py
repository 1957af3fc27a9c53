# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.evaluation.association import associate, interpolate_poses


def ns(stamps_s):
    return np.rint(np.array(stamps_s) * 1e9).astype(np.int64)


def test_pairs_each_stamp_with_the_nearest_reference():
    index, reference_index = associate(ns([0.1004, 0.2496, 0.9]), ns(np.arange(0.0, 1.0, 0.01)), 0.005)
    assert index.tolist() == [0, 1, 2]
    assert reference_index.tolist() == [10, 25, 90]


def test_leaves_out_what_is_further_apart_than_tau():
    index, reference_index = associate(ns([0.0, 1.0, 2.0]), ns([0.009, 1.011, 2.0]), 0.01)
    assert index.tolist() == [0, 2]
    assert reference_index.tolist() == [0, 2]


def test_one_reference_serves_one_stamp_only():
    index, reference_index = associate(ns([0.98, 1.01, 1.03]), ns([0.0, 1.0, 5.0]), 0.1)
    assert index.tolist() == [1]
    assert reference_index.tolist() == [1]


def test_one_stamp_is_paired_with_one_of_many_references():
    index, reference_index = associate(ns([1.0]), ns([0.999, 1.0005, 1.002]), 0.01)
    assert index.tolist() == [0]
    assert reference_index.tolist() == [1]


def test_swapping_the_trajectories_swaps_the_pairs():
    rng = np.random.default_rng(1)
    a, b = (ns(np.sort(rng.uniform(0, 10, count))) for count in (200, 300))
    in_a, in_b = associate(a, b, 0.02)
    in_b_swapped, in_a_swapped = associate(b, a, 0.02)
    assert len(in_a) > 50
    assert np.array_equal(in_a, in_a_swapped)
    assert np.array_equal(in_b, in_b_swapped)
    assert np.all(np.diff(in_a) > 0)
    assert np.all(np.diff(in_b) > 0)


@pytest.mark.parametrize(("stamps", "reference"), [([], [1.0]), ([1.0], []), ([1.0], [3.0])])
def test_nothing_in_common_gives_no_pairs(stamps, reference):
    index, reference_index = associate(ns(stamps), ns(reference), 0.5)
    assert len(index) == len(reference_index) == 0


@pytest.mark.parametrize("begin_ns", [0, 1_732_800_000_123_456_789])
def test_interpolation_is_exact_for_constant_velocity_wherever_the_clock_begins(begin_ns):
    times_s = np.array([0.0, 1.0, 2.0])
    wanted_s = np.array([0.0, 0.25, 1.5, 2.0])

    def poses_at(t):
        poses = np.tile(np.eye(4), (len(t), 1, 1))
        poses[:, :3, 3] = np.outer(t, [1.0, -2.0, 0.5])
        poses[:, :3, :3] = Rotation.from_rotvec(np.outer(t, [0.2, 0.3, -0.4])).as_matrix()
        return poses

    found = interpolate_poses(begin_ns + ns(times_s), poses_at(times_s), begin_ns + ns(wanted_s))
    assert np.allclose(found, poses_at(wanted_s), atol=1e-12)


@pytest.mark.parametrize("offset_ns", [-50_000_000, 50_000_000])
def test_stamps_exactly_between_those_of_the_reference_are_all_paired(offset_ns):
    reference_ns = 100_000_000 * np.arange(10)
    index, reference_index = associate(reference_ns + offset_ns, reference_ns, 0.06)
    assert len(index) >= 9
    assert len(set(reference_index.tolist())) == len(index)
