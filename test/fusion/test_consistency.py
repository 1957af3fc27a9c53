# SPDX-License-Identifier: BSD-3-Clause
"""Whether the errors are as large as the covariances say: mean NEES of 50 runs within its 95 % bounds.

Of drives that the camera sees from end to end, and of drives of which it does not see 5 s.
"""

import numpy as np
import pytest
from fused_drive import drawn_runs
from scipy.stats import chi2

pytestmark = pytest.mark.long
RUNS, SECONDS = 50, 30.0


@pytest.fixture(scope="module", params=[(), ((20.0, 25.0),)], ids=["seeing", "blind for 5 s"])
def errors(request):
    return list(drawn_runs(RUNS, SECONDS, request.param))


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
