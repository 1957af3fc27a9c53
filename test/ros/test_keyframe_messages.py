# SPDX-License-Identifier: BSD-3-Clause
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("ceiling_dso_ros.msg", reason="needs ROS and the built workspace")
pytestmark = pytest.mark.ros

from ceiling_dso_ros.fusion.leaving import LeavingKeyframe  # noqa: E402
from ceiling_dso_ros.fusion.tilt import Tilt  # noqa: E402
from ceiling_dso_ros.ros.keyframe_messages import left_from_message, left_messages  # noqa: E402

COVARIANCE = np.array([[4e-6, 1e-6, 0.0], [1e-6, 5e-6, 0.0], [0.0, 0.0, 1e-6]])
LEFT = LeavingKeyframe(
    *(7, 1_000_000_000, 900_000_000, np.array([1.0, 2.0, 0.3]), np.array([0.2, 0.01, 0.05]), COVARIANCE, 4.1),
    *(1_500_000_000, np.array([0.4, 0.0, 0.1]), Tilt(np.array([0.004, -0.002]), np.array([8e-4, 5e-4]))),
)


def told(left):
    """The message of fusion_node, whose odom begins at its first wheel sample."""
    robot = SimpleNamespace(T_base_camera=np.eye(4))
    estimator = SimpleNamespace(take_left=lambda: [left], origin=np.zeros(3), robot=robot)
    (message,) = left_messages(estimator, SimpleNamespace(stamp_ns=lambda stamp_ns: stamp_ns))
    return message


def test_what_fusion_node_tells_of_a_keyframe_is_what_map_node_hears():
    heard = left_from_message(told(LEFT))
    assert (heard.keyframe_id, heard.image_ns, heard.before_ns, heard.newest_ns) == (7, 10**9, 9 * 10**8, 15 * 10**8)
    for name in ("pose", "motion", "covariance", "to_newest"):
        np.testing.assert_allclose(getattr(heard, name), getattr(LEFT, name), atol=1e-15, err_msg=name)
    np.testing.assert_array_equal(heard.tilt, LEFT.tilt)
    assert heard.metres_per_unit == LEFT.metres_per_unit


@pytest.mark.parametrize(
    "tilt",
    [Tilt(np.array([np.nan, 0.0]), np.full(2, 1e-3)), Tilt(np.array([0.0, 0.9]), np.full(2, 1e-3)),
     Tilt(np.zeros(2), np.array([1e-3, 0.0])), Tilt(np.zeros(2), np.array([np.inf, 1e-3]))],
)  # fmt: skip
def test_a_tilt_that_makes_no_sense_is_refused(tilt):
    with pytest.raises(ValueError, match="a tilt"):
        left_from_message(told(replace(LEFT, tilt=tilt)))
