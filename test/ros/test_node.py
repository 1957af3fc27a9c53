# SPDX-License-Identifier: BSD-3-Clause
"""What all nodes have in common."""

import pytest

pytest.importorskip("ceiling_dso_ros.msg", reason="needs ROS and the built workspace")
pytestmark = pytest.mark.ros

import rospy  # noqa: E402

from ceiling_dso_ros.ros import node  # noqa: E402


@pytest.mark.parametrize(
    ("is_simulated", "time_s", "lines"), [(True, 0.0, 1), (True, 5.0, 0), (False, 0.0, 0), (False, 5.0, 0)]
)
def test_a_clock_that_nobody_publishes_is_said(monkeypatch, is_simulated, time_s, lines):
    """After a playback the parameter stays on the master, and time stands still on the robot."""
    said = []
    monkeypatch.setattr(rospy, "get_param", lambda *_: is_simulated)
    monkeypatch.setattr(rospy, "get_time", lambda: time_s)
    monkeypatch.setattr(rospy, "is_shutdown", lambda: False)
    monkeypatch.setattr(rospy, "logwarn", said.append)
    node._warn_without_clock()
    assert len(said) == lines
    assert all("rosparam set /use_sim_time false" in line for line in said)
