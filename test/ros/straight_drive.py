# SPDX-License-Identifier: BSD-3-Clause
"""A drive as the messages of the nodes tell it."""

from io import BytesIO

import numpy as np
from std_msgs.msg import Header

from ceiling_dso_ros.dso import KeyframeEstimate, OdometryStatus, TrackingState
from ceiling_dso_ros.ros.conversions import ros_time, status_message


def sent(message):
    """As it arrives."""
    buffer = BytesIO()
    message.serialize(buffer)
    return type(message)().deserialize(buffer.getvalue())


class Drive:
    """Straight on below a ceiling, at today's epoch: wheels at 50 Hz, images at 30 Hz, every fifth a keyframe."""

    BEGIN_NS, HEIGHT_M, SPEED_M_S = 1_732_800_000_123_456_789, 4.0, 0.8

    def wheels(self, until_ns):
        """(stamp, pose) of each sample up to a stamp."""
        for k in range((until_ns - self.BEGIN_NS) // 20_000_000 + 1):
            yield self.BEGIN_NS + k * 20_000_000, np.array([self.SPEED_M_S * k / 50, 0.0, 0.0])

    def image(self, k):
        """What dso_node says of an image."""
        poses = {key: np.eye(4) for key in range(max(0, k // 5 - 6), k // 5 + 1)}
        for key, T in poses.items():
            T[0, 3] = self.SPEED_M_S * key / 6 / self.HEIGHT_M
        keyframes = tuple(
            KeyframeEstimate(key, self.image_ns(5 * key), 0, T, (0.0, 0.0), False) for key, T in poses.items()
        )
        T_keyframe_camera = np.eye(4)
        T_keyframe_camera[0, 3] = self.SPEED_M_S * (k % 5) / 30 / self.HEIGHT_M
        status = OdometryStatus(
            self.image_ns(k), TrackingState.TRACKING, 0, np.eye(4), keyframe_id=k // 5,
            T_keyframe_camera=T_keyframe_camera, keyframes=keyframes if k % 5 == 0 else (),
        )  # fmt: skip
        return sent(status_message(Header(stamp=ros_time(status.stamp_ns), frame_id="vo"), status))

    def image_ns(self, k):
        return self.BEGIN_NS + 7_654_321 + k * 33_333_333
