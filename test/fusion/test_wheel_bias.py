# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from scipy.stats import chi2

from ceiling_dso_ros.fusion.config import VisualConfig, WheelConfig
from ceiling_dso_ros.fusion.graph import Interval
from ceiling_dso_ros.fusion.visual import VisualMotion
from ceiling_dso_ros.fusion.wheel_bias import WANDER_WAY_M, WheelBias
from ceiling_dso_ros.fusion.wheel_motion import WheelMotion, WheelNoise, WheelStep

NOISE = WheelNoise(WheelConfig(), 0.5, 1e-4)
PRIOR = NOISE.constants_covariance(with_radius=False)[1:, 1:]
STRAIGHT, CURVE = np.array([0.2, 0.0, 0.0]), np.array([0.15, 0.0, 0.15])


def drive(twists, true=(0.0, 0.0), rng=None, **changes):
    """Intervals of true arcs, seen by the camera and by wheels with true (ln ratio, ln base) and their noise."""
    intervals = []
    for end, twist in enumerate(twists, start=1):
        step = NOISE.corrected(WheelStep((end - 1) * 10**9, end * 10**9, twist), -np.array(true))
        if rng is not None:
            error = np.linalg.cholesky(NOISE.white(step) + 1e-12 * np.eye(3)) @ rng.normal(size=3)
            step = WheelStep(step.start_ns, step.end_ns, step.twist + error)
        wheels = NOISE.extend(WheelMotion.nothing(step.start_ns), step)
        visual = VisualMotion(twist[:2] / 4.0, 0.0, twist[2], np.zeros(2), np.zeros(3))
        intervals.append(Interval(end, end * 10**9, wheels, **{"visual": visual, "continues": True, **changes}))
    return intervals


def learnt(intervals):
    bias = WheelBias(NOISE, VisualConfig(yaw_sigma_rad=2e-4))
    for interval in intervals:
        bias.learn(interval)
    return bias


def test_at_first_the_wheels_are_as_configured():
    bias = WheelBias(NOISE, VisualConfig(yaw_sigma_rad=2e-4))
    np.testing.assert_array_equal(bias.constants, 0.0)
    np.testing.assert_array_equal(bias.covariance, PRIOR)


def test_curves_both_ways_tell_ratio_and_base():
    true = (0.01, -0.008)
    twists = [CURVE * [1.0, 1.0, np.sign(np.sin(0.1 * k))] for k in range(300)]
    bias = learnt(drive(twists, true))
    np.testing.assert_allclose(bias.constants, true, rtol=0.2)
    assert (np.diag(bias.covariance) < 0.3 * np.diag(PRIOR)).all()


def test_a_straight_way_tells_the_ratio_alone():
    bias = learnt(drive([STRAIGHT] * 100, (0.01, 0.01)))
    assert bias.constants[0] == pytest.approx(0.01, rel=0.2)
    assert bias.constants[1] == pytest.approx(0.0, abs=3e-4)
    assert bias.covariance[1, 1] == pytest.approx(PRIOR[1, 1], rel=0.01)


def test_errors_are_as_large_as_the_covariance_says():
    """Of constants that wander as they are expected to."""
    rng, runs, squares = np.random.default_rng(5), 60, []
    for _ in range(runs):
        true, bias = rng.multivariate_normal(np.zeros(2), PRIOR), WheelBias(NOISE, VisualConfig(yaw_sigma_rad=2e-4))
        for k in range(80):
            twist = CURVE * [1.0, 1.0, np.sign(np.sin(0.1 * k))]
            kept = np.exp(-(twist[0] + 0.25 * abs(twist[2])) / WANDER_WAY_M)
            true = kept * true + np.sqrt(1.0 - kept**2) * rng.multivariate_normal(np.zeros(2), PRIOR)
            bias.learn(*drive([twist], true, rng))
        error = bias.constants - true
        squares.append(error @ np.linalg.solve(bias.covariance, error))
    low, high = chi2.ppf([0.025, 0.975], 2 * runs) / runs
    assert low < np.mean(squares) < high


@pytest.mark.parametrize("changes", [{"visual": None}, {"wheels_slip": True}], ids=["without camera", "slip"])
def test_nothing_is_learnt_without_a_camera_or_from_slip(changes):
    bias = learnt(drive([STRAIGHT] * 100, (0.01, 0.01), **changes))
    np.testing.assert_array_equal(bias.constants, 0.0)
    np.testing.assert_allclose(bias.covariance, PRIOR)


def test_what_was_learnt_is_forgotten_over_a_long_blind_way():
    intervals = drive([CURVE] * 100, (0.01, 0.01))
    before = learnt(intervals)
    after = learnt([*intervals, *drive([20.0 * STRAIGHT] * 100, visual=None)])
    assert np.abs(before.constants).max() > 0.003
    np.testing.assert_allclose(after.constants, 0.0, atol=1e-4)
    np.testing.assert_allclose(after.covariance, PRIOR, atol=0.01 * PRIOR.max())


def test_a_bridge_is_as_uncertain_as_what_was_learnt():
    bias = learnt(drive([STRAIGHT] * 100, (0.01, 0.0)))
    (interval,) = drive([5.0 * STRAIGHT])
    known, configured = np.zeros((3, 3)), np.zeros((3, 3))
    known[1:, 1:], configured[1:, 1:] = bias.covariance, PRIOR
    found = NOISE.covariance(bias.bridge(interval.wheels), configured)
    np.testing.assert_allclose(found, NOISE.covariance(interval.wheels, known), atol=1e-15)
    assert found[2, 2] < NOISE.covariance(interval.wheels, configured)[2, 2]
