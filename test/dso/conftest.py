# SPDX-License-Identifier: BSD-3-Clause
"""Makes the helpers of this directory importable from its test files, and the flight's images a fixture."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(scope="session")
def images():
    import flying

    return flying.render()


@pytest.fixture(scope="session")
def flight(images):
    """What the odometry makes of them."""
    import flying
    from synthetic import CAMERA

    from ceiling_dso_ros.dso import DirectOdometry

    return flying.run(DirectOdometry(CAMERA, flying.CONFIG), images)
