# SPDX-License-Identifier: BSD-3-Clause
"""Whether the errors of many drives are as large as the covariances say: mean NEES within its 95 % bounds."""

import numpy as np
from fused_drive import drawn_runs
from scipy.stats import chi2

RUNS, SECONDS = 50, 30.0


def errors_of_drives(unseen=()):
    """Errors at the end of 50 drives of 30 s, of which the camera does not see some stretches."""
    return list(drawn_runs(RUNS, SECONDS, unseen))


def require_within_bounds(nees, dimensions):
    low, high = chi2.ppf([0.025, 0.975], RUNS * dimensions) / RUNS
    assert low < np.mean(nees) < high


def require_consistent_poses(errors):
    require_within_bounds([error @ np.linalg.solve(covariance, error) for error, covariance, _, _ in errors], 3)


def require_consistent_scales(errors):
    require_within_bounds([(error / sigma) ** 2 for _, _, error, sigma in errors], 1)
