# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.dso.status import NO_SCALE
from ceiling_dso_ros.dso.stereo.scale import CELLS, PointScales, cells, estimate_scale

FB = 40.4  # pixels per 1/m


def points(
    rng, scale=4.0, count=800, map_sigma=0.03, image_sigma=0.1, shared=0.0, outliers=0.0, new=1.0, disparity=8.0
):
    """Points under a ceiling with beams, with noise in depths and places, some of it shared in parts of the image."""
    u, v = rng.uniform(0, 848, count), rng.uniform(0, 480, count)
    cell = cells(u, v, 848, 480)
    truth = disparity / FB * rng.choice([1.0, 1.0, 1.3], count)  # 1/m
    noise = map_sigma * (np.sqrt(1 - shared) * rng.normal(size=count)
                         + np.sqrt(shared) * rng.normal(size=CELLS * CELLS)[cell])  # fmt: skip
    mapped = scale * truth * (1.0 + noise)
    measured = truth + image_sigma / FB * rng.normal(size=count)
    wrong = rng.random(count) < outliers
    measured[wrong] += rng.uniform(-2.0, 2.0, wrong.sum()) / FB
    return PointScales(
        mapped,
        measured,
        np.full(count, FB),
        np.full(count, image_sigma),
        cell,
        rng.random(count) < new,
        np.arange(count),
    )


@pytest.mark.parametrize("shared", [0.0, 0.5])
@pytest.mark.parametrize("outliers", [0.0, 0.1])
def test_errors_agree_with_the_standard_deviation_and_have_no_mean(shared, outliers):
    found = [
        estimate_scale(points(np.random.default_rng(seed), shared=shared, outliers=outliers), 0.0, 0.0)
        for seed in range(300)
    ]
    errors = np.array([each.log_scale for each in found]) - np.log(4.0)
    sigmas = np.array([each.sigma for each in found])
    assert np.mean((errors / sigmas) ** 2) == pytest.approx(1.0, abs=0.3)
    assert abs(np.mean(errors)) < 4.0 * np.std(errors) / np.sqrt(300)


def test_noise_of_depths_and_places_does_not_bias_the_scale():
    """Ten times the usual noise: the mean of logarithms or of ratios would be wrong by a percent."""
    found = [
        estimate_scale(points(np.random.default_rng(seed), map_sigma=0.15, image_sigma=0.8, disparity=5.0), 0.0, 0.0)
        for seed in range(300)
    ]
    assert np.mean([each.log_scale for each in found]) == pytest.approx(np.log(4.0), abs=0.003)


def test_points_that_were_used_before_tell_nothing_new():
    rng = np.random.default_rng(0)
    seen = points(rng)
    every = estimate_scale(seen, 0.0, 0.0)
    half = estimate_scale(seen._replace(is_new=np.arange(800) % 2 == 0), 0.0, 0.0)
    assert half.log_scale == every.log_scale
    assert half.sigma == pytest.approx(np.sqrt(2.0) * every.sigma, rel=0.05)
    assert estimate_scale(seen._replace(is_new=np.zeros(800, bool)), 0.0, 0.0) is NO_SCALE


def test_what_all_keyframes_have_in_common_is_said_apart():
    rng = np.random.default_rng(0)
    seen = points(rng, disparity=8.0)
    found = estimate_scale(seen, 0.003, 0.0)
    assert found.common_sigma == pytest.approx(0.003)
    assert found.sigma == estimate_scale(seen, 0.0, 0.0).sigma
    shifted = seen._replace(measured=seen.measured + 0.05 / FB)
    moved = estimate_scale(shifted, 0.0, 0.05)
    assert abs(moved.log_scale - estimate_scale(seen, 0.0, 0.0).log_scale) == pytest.approx(
        moved.common_sigma, rel=0.03
    )


def test_few_points_tell_nothing():
    assert estimate_scale(points(np.random.default_rng(0), count=20), 0.0, 0.0) is NO_SCALE


def test_cells_cover_the_image():
    assert cells(np.array([0.0, 847.9, 424.0]), np.array([0.0, 479.9, 0.0]), 848, 480).tolist() == [0, 63, 4]
