# SPDX-License-Identifier: BSD-3-Clause
"""The path for display is thinned, and neither made nor sent by those who add poses to it."""

from io import BytesIO

import pytest

pytest.importorskip("rospy", reason="needs ROS")
pytestmark = pytest.mark.ros

from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion  # noqa: E402
from nav_msgs.msg import Path  # noqa: E402
from std_msgs.msg import Header  # noqa: E402

from ceiling_dso_ros.ros import paths  # noqa: E402
from ceiling_dso_ros.ros.conversions import ros_time  # noqa: E402


class FakePublisher:
    """Of a topic with one subscriber."""

    def __init__(self, *_args, **_kwargs):
        self.sent, self.listeners = [], 1

    def get_num_connections(self):
        return self.listeners

    def publish(self, message):
        buffer = BytesIO()
        message.serialize(buffer)
        self.sent.append(Path().deserialize(buffer.getvalue()))


class ByHand:
    """Does the work when it is asked to."""

    def __init__(self, work, period_s, name):
        self.period_s, self.once = period_s, work


@pytest.fixture
def path(monkeypatch):
    monkeypatch.setattr(paths.rospy, "Publisher", FakePublisher)
    monkeypatch.setattr(paths, "Periodic", ByHand)
    return paths.PathPublisher("path", spacing=0.1, length=20)


def pose(number, x):
    header = Header(stamp=ros_time(1_732_800_000_123_456_789 + number), frame_id="odom")
    return PoseStamped(header, Pose(Point(x, 2.0, 3.0), Quaternion(0.0, 0.0, 0.6, 0.8)))


def sent(path):
    path._sending.once()
    return path._publisher.sent


def test_the_message_is_the_path_of_the_poses(path):
    added = [pose(number, 0.2 * number) for number in range(5)]
    for one in added:
        path.add(one)
    (message,) = sent(path)
    assert message.poses == added
    assert (message.header.stamp, message.header.frame_id) == (added[-1].header.stamp, "odom")


def test_it_is_thinned_and_ends_where_the_robot_is(path):
    for number in range(101):
        path.add(pose(number, 0.015 * number))
    for number in range(101, 5000):  # standing
        path.add(pose(number, 1.51))
    places = [one.pose.position.x for one in sent(path)[-1].poses]
    steps = [after - before for before, after in zip(places, places[1:])]
    assert 10 <= len(places) <= 16
    assert min(steps[:-1]) >= 0.1
    assert places[-1] == 1.51


def test_only_the_newest_poses_are_kept(path):
    for number in range(100):
        path.add(pose(number, float(number)))
    assert [one.pose.position.x for one in sent(path)[-1].poses] == [*map(float, range(80, 100))]
    path.length = 10
    path.add(pose(100, 100.0))
    assert len(sent(path)[-1].poses) == 10


def test_nothing_is_sent_without_news_or_listeners_or_poses(path):
    assert sent(path) == []
    path.add(pose(0, 0.0))
    path._publisher.listeners = 0
    assert sent(path) == []
    path._publisher.listeners = 1
    path.add(pose(1, 1.0))
    assert len(sent(path)) == 1
    assert len(sent(path)) == 1
    path.add(pose(2, 2.0))
    path.clear()
    assert len(sent(path)) == 1


def test_poses_are_added_while_a_path_is_sent(path):
    """Whoever publishes the robot's pose does not wait for the display."""
    publish = path._publisher.publish

    def slow(message):
        path.add(pose(1, 1.0))
        publish(message)

    path._publisher.publish = slow
    path.add(pose(0, 0.0))
    assert [len(message.poses) for message in sent(path)] == [1]
    assert [len(message.poses) for message in sent(path)] == [1, 2]
