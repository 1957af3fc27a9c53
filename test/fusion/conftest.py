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
