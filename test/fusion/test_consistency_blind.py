# SPDX-License-Identifier: BSD-3-Clause
"""Errors against covariances, of drives of which the camera does not see 5 s.

A file of its own, because it takes minutes and files run beside each other.
"""

import pytest
from consistency import errors_of_drives, require_consistent_poses, require_consistent_scales

pytestmark = pytest.mark.long(minutes=10)


@pytest.fixture(scope="module")
def errors():
    return errors_of_drives(((20.0, 25.0),))


def test_pose(errors):
    require_consistent_poses(errors)


def test_log_scale(errors):
    require_consistent_scales(errors)
