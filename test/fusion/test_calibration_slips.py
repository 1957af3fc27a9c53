# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.fusion.calibration_slips import slipping

PAIRS, WAY_M = 60, 0.5
AXES = pytest.mark.parametrize("axis", range(3))


def slips_of(excess_m, follow=None):
    used, way_m = np.ones(PAIRS, bool), np.full(PAIRS, WAY_M)
    follow = np.ones(PAIRS - 1, bool) if follow is None else follow
    return list(np.flatnonzero(slipping(excess_m, used, way_m, follow)))


@pytest.fixture
def noise_m():
    """What errors of the poses of 2 mm at most make of the pairs."""
    poses_m = 0.001 * np.random.default_rng(0).uniform(-2.0, 2.0, (PAIRS + 1, 3))
    return np.diff(poses_m, axis=0)


@AXES
@pytest.mark.parametrize("pair", [0, 30, PAIRS - 1])
def test_an_excess_that_stays_is_a_slip(noise_m, axis, pair):
    noise_m[pair, axis] += 0.02
    assert pair in slips_of(noise_m)


@AXES
def test_an_error_of_one_pose_is_none(noise_m, axis):
    noise_m[30, axis] += 0.015
    noise_m[31, axis] -= 0.015
    assert slips_of(noise_m) == []


@AXES
def test_pairs_of_other_images_take_nothing_back(noise_m, axis):
    noise_m[30, axis] += 0.02
    noise_m[31, axis] -= 0.02
    follow = np.ones(PAIRS - 1, bool)
    follow[30] = False
    assert {30, 31} <= set(slips_of(noise_m, follow))


@AXES
def test_wheels_that_slip_forward_and_back_slip(noise_m, axis):
    noise_m[30, axis] += 0.3 * WAY_M
    noise_m[31, axis] -= 0.3 * WAY_M
    assert {30, 31} <= set(slips_of(noise_m))


@AXES
def test_one_that_is_cut_by_an_image_is_a_slip(noise_m, axis):
    noise_m[[30, 31], axis] += 0.012
    assert {30, 31} & set(slips_of(noise_m))
