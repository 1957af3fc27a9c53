# SPDX-License-Identifier: BSD-3-Clause
"""Makes the modules beside this file importable from the tests, and what they simulate available as fixtures."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from fused_drive import fuse_drive
from simulated_drive import Truth, simulate_drive


@pytest.fixture(scope="session")
def simulate():
    return simulate_drive


@pytest.fixture(scope="session")
def truth():
    return Truth


@pytest.fixture(scope="session")
def fuse():
    return fuse_drive


@pytest.fixture
def robot_truth(truth):
    """1 % of ratio and base, noisy encoders, exact mean radius, a poor camera."""
    return truth(ratio=0.01, base=0.01, wheel_noise=0.002, shift_sigma=2.2e-4, turn_sigma=3.5e-4)


@pytest.fixture(scope="module")
def loops(simulate, truth):
    return simulate("loops", 25.0, 3, truth(ratio=0.01, base=0.01))


@pytest.fixture(scope="module")
def fused(loops, fuse):
    return fuse(loops)
