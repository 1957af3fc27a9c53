# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.dso.status import NO_SCALE, KeyframeEstimate, ScaleMeasurement
from ceiling_dso_ros.fusion.config import FusionConfig, ScaleConfig
from ceiling_dso_ros.fusion.metric_scale import metric_positions, segment_scales

STEP = 0.05  # units, from keyframe to keyframe
SIGMA, COMMON = 0.004, 0.003


def keyframe(number, log_scale=np.nan, segment=0, sigma=SIGMA, x=None):
    T = np.eye(4)
    T[0, 3] = STEP * number if x is None else x
    scale = NO_SCALE if np.isnan(log_scale) else ScaleMeasurement(log_scale, sigma, COMMON)
    return KeyframeEstimate(number, number * 10**9, segment, T, (0.0, 0.0), False, scale=scale)


def walking(count, rng, walk=FusionConfig().scale.walk_sigma):
    """Log-scales that drift as the fusion assumes, and what is measured of them."""
    true = 1.4 + np.cumsum(walk * np.sqrt(STEP) * rng.normal(size=count))
    return true, [keyframe(k, z) for k, z in enumerate(true + SIGMA * rng.normal(size=count))]


def test_errors_agree_with_the_standard_deviation():
    """Also where the scale drifts a hundred times as fast as it usually does."""
    for walk in (4e-4, 4e-2):
        config, errors = FusionConfig(scale=ScaleConfig(walk_sigma=walk)), []
        for seed in range(200):
            true, keyframes = walking(60, np.random.default_rng(seed), walk)
            found = segment_scales(keyframes, config)[0]
            errors.append((np.mean(found.log_scales) - np.mean(true)) / found.sigma)
        assert np.mean(np.square(errors)) == pytest.approx(1.0, abs=0.3)
        assert found.common_sigma == COMMON


def test_the_estimate_is_that_of_least_squares():
    _, keyframes = walking(12, np.random.default_rng(0))
    keyframes[3] = keyframe(3)  # without a measurement
    walk = FusionConfig().scale.walk_sigma * np.sqrt(STEP)
    rows = [(np.eye(12)[k + 1] - np.eye(12)[k]) / walk for k in range(11)]
    measured = [k for k in range(12) if k != 3]
    rows += [np.eye(12)[k] / SIGMA for k in measured]
    sides = [0.0] * 11 + [keyframes[k].scale.log_scale / SIGMA for k in measured]
    expected, *_ = np.linalg.lstsq(np.array(rows), np.array(sides), rcond=None)
    found = segment_scales(keyframes)[0]
    np.testing.assert_allclose(found.log_scales, expected, atol=1e-9)
    mean = np.full(12, 1 / 12)
    covariance = np.linalg.inv(np.transpose(rows) @ np.array(rows))
    assert found.sigma == pytest.approx(np.sqrt(mean @ covariance @ mean))


def test_a_wrong_measurement_does_little_harm():
    true, keyframes = walking(60, np.random.default_rng(0))
    before = segment_scales(keyframes)[0].log_scales
    keyframes[30] = keyframe(30, true[30] + 0.7)
    after = segment_scales(keyframes)[0].log_scales
    assert np.abs(after - before).max() < 4.0 * SIGMA / 60 * 2


def test_segments_have_scales_of_their_own_and_only_where_they_are_told():
    keyframes = [*(keyframe(k, 1.0) for k in range(5)), *(keyframe(k, segment=1) for k in range(5, 9))]
    keyframes += [keyframe(k, 2.0, segment=2) for k in range(9, 12)]
    found = segment_scales(reversed(keyframes))
    assert sorted(found) == [0, 2]
    np.testing.assert_allclose(found[0].log_scales, 1.0)
    np.testing.assert_allclose(found[2].log_scales, 2.0)
    assert segment_scales([]) == {}


def test_positions_in_metres():
    """Two segments with different units, between them one whose unit is not known."""
    keyframes = [keyframe(k, np.log(2.0)) for k in range(4)] + [keyframe(k, np.log(5.0), segment=2) for k in (8, 9)]
    stamps_ns = np.arange(10) * 10**9
    segments = np.array([0, 0, 0, 0, 1, 1, 1, 2, 2, 2])
    positions = np.column_stack([np.arange(10.0), np.zeros((10, 2))])
    found = metric_positions(stamps_ns, segments, positions, segment_scales(keyframes))
    np.testing.assert_allclose(found[:4, 0], [0, 2, 4, 6])
    assert np.isnan(found[4:7]).all()
    np.testing.assert_allclose(found[7:, 0], [11, 16, 21])


def test_the_scale_between_keyframes_and_beyond():
    config = FusionConfig(scale=ScaleConfig(walk_sigma=0.1))
    scale = segment_scales([keyframe(k, 1.0 + 0.01 * k, sigma=1e-4) for k in range(3)], config)[0]
    found = scale.at(np.array([-5, 0, 0.5, 2, 9]) * 10**9)
    np.testing.assert_allclose(found, [1.0, 1.0, 1.005, 1.02, 1.02], atol=2e-4)
