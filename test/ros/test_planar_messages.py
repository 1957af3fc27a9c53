# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

pytest.importorskip("ceiling_dso_ros.msg", reason="needs ROS and the built workspace")
pytestmark = pytest.mark.ros

from geometry_msgs.msg import Pose  # noqa: E402
from std_msgs.msg import Header  # noqa: E402

from ceiling_dso_ros.io.ros_messages import planar_pose  # noqa: E402
from ceiling_dso_ros.ros import planar_messages  # noqa: E402

POSE = np.array([1.0, -2.0, 2.5])


def odometry(covariance=np.diag([1.0, 2.0, 3.0]), twist_covariance=np.diag([4.0, 5.0])):
    twist = np.array([0.5, -0.25])
    return planar_messages.planar_odometry(Header(frame_id="odom"), "base", POSE, covariance, twist, twist_covariance)


def test_pose_there_and_back():
    np.testing.assert_allclose(planar_pose(odometry().pose.pose), POSE, atol=1e-12)


def test_twist_is_that_of_the_child():
    message = odometry()
    assert (message.header.frame_id, message.child_frame_id) == ("odom", "base")
    assert (message.twist.twist.linear.x, message.twist.twist.angular.z) == (0.5, -0.25)


def test_covariances_are_where_they_belong_and_never_singular():
    message = odometry()
    pose, twist = (np.reshape(part.covariance, (6, 6)) for part in (message.pose, message.twist))
    np.testing.assert_allclose(pose.diagonal()[[0, 1, 5]], [1.0, 2.0, 3.0], rtol=1e-6)
    np.testing.assert_allclose(twist.diagonal()[[0, 5]], [4.0, 5.0], rtol=1e-6)
    nothing = odometry(np.zeros((3, 3)), np.zeros((2, 2)))
    for part in (nothing.pose, nothing.twist):
        assert np.linalg.eigvalsh(np.reshape(part.covariance, (6, 6))).min() > 0.0


@pytest.mark.parametrize("field", ["w", "x"])
def test_poses_that_are_none_are_refused(field):
    pose = Pose()
    with pytest.raises(ValueError, match="zero"):
        planar_pose(pose)
    setattr(pose.orientation, field, float("nan"))
    with pytest.raises(ValueError, match="not finite"):
        planar_pose(pose)
