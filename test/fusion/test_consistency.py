"""Whether the errors are as large as the covariances say: mean NEES of 50 runs within its 95 % bounds."""

import numpy as np
import pytest
from scipy.stats import chi2

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.config import FusionConfig, WheelConfig

pytestmark = pytest.mark.long
RUNS, SECONDS = 50, 30.0
WHEELS = WheelConfig()


@pytest.fixture(scope="module")
def errors(simulate, truth, fuse):
    """Errors and covariances at the end of runs whose truth is drawn from what the settings say of it."""
    rng, result = np.random.default_rng(7), []
    for seed in range(RUNS):
        drawn = truth(
            ratio=WHEELS.ratio_sigma * rng.normal(),
            base=WHEELS.base_sigma * rng.normal(),
            radius=WHEELS.radius_sigma * rng.normal(),
            wheel_noise=WHEELS.noise_m_per_sqrt_m,
            unit_m=4.5 * np.exp(0.2 * rng.normal()),
        )
        fused = fuse(simulate(("loops", "square")[seed % 2], SECONDS, seed, drawn), FusionConfig(), False)
        last = fused.states[-1]
        true = fused.drive.pose_at(last.stamp_s)
        error = np.array([*(last.pose - true)[:2], planar.wrap(last.pose[2] - true[2])])
        _, key, scale = fused.scales[-1]
        result.append((error, last.covariance, np.log(scale.value / fused.drive.metres_per_unit[key]), scale.sigma))
    return result


def bounds(dimensions):
    return chi2.ppf([0.025, 0.975], RUNS * dimensions) / RUNS


def test_pose(errors):
    nees = np.mean([error @ np.linalg.solve(covariance, error) for error, covariance, _, _ in errors])
    low, high = bounds(3)
    assert low < nees < high


def test_log_scale(errors):
    nees = np.mean([(error / sigma) ** 2 for _, _, error, sigma in errors])
    low, high = bounds(1)
    assert low < nees < high
