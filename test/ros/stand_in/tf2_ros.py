# SPDX-License-Identifier: BSD-3-Clause
"""What the nodes use of tf2_ros, for a Python that tf2's compiled part is not built for: single transforms only."""

import rospy
from tf2_msgs.msg import TFMessage


class TransformException(Exception):  # noqa: N818
    """As tf2's."""


class TransformBroadcaster:
    """Publishes on /tf."""

    def __init__(self):
        self._publisher = rospy.Publisher("/tf", TFMessage, queue_size=100)

    def sendTransform(self, transform):
        """Of one TransformStamped."""
        self._publisher.publish(TFMessage([transform]))


class Buffer:
    """Knows the newest transform of every pair of frames."""

    def __init__(self):
        self.transforms = {}

    def lookup_transform(self, target_frame, source_frame, time):
        """The newest, whatever the time; pairs are not chained."""
        if (target_frame, source_frame) not in self.transforms:
            raise TransformException(f"no transform from {source_frame} to {target_frame}")
        return self.transforms[target_frame, source_frame]


class TransformListener:
    """Fills a Buffer."""

    def __init__(self, buffer):
        self._buffer = buffer
        self._subscribers = [rospy.Subscriber(topic, TFMessage, self._on_tf) for topic in ("/tf", "/tf_static")]

    def unregister(self):
        """Listen no longer."""
        for subscriber in self._subscribers:
            subscriber.unregister()

    def _on_tf(self, message):
        for transform in message.transforms:
            self._buffer.transforms[transform.header.frame_id, transform.child_frame_id] = transform
