# SPDX-License-Identifier: BSD-3-Clause
from pathlib import Path

import numpy as np
import pytest

from ceiling_dso_ros.io.ros_messages import (
    EXTRA_DEFINITIONS,
    header,
    header_stamp_ns,
    pose,
    transform_matrix,
    transform_stamped,
)

MESSAGES = Path(__file__).parents[2] / "msg"


def test_exposure_is_defined_as_in_the_package():
    lines = (line.split("#")[0].split() for line in (MESSAGES / "Exposure.msg").read_text().splitlines())
    definition = "\n".join(" ".join(words) for words in lines if words)
    assert definition == EXTRA_DEFINITIONS["ceiling_dso_ros/msg/Exposure"]


@pytest.mark.parametrize("stamp_ns", [0, 999_999_999, 1_700_000_001_030_042_017])
def test_stamps_are_exact(stamp_ns):
    assert header_stamp_ns(header(stamp_ns, "camera")) == stamp_ns


def test_transforms_come_back():
    T = np.array([[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1.0]])
    parent, child, back = transform_matrix(transform_stamped(5, "base_link", "camera", T))
    assert (parent, child) == ("base_link", "camera")
    np.testing.assert_allclose(back, T, atol=1e-15)
    assert (pose(T).position.x, pose(T).position.y, pose(T).position.z) == (1, 2, 3)
    assert pose(T).orientation.z == pytest.approx(np.sqrt(0.5))
