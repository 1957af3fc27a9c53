# SPDX-License-Identifier: BSD-3-Clause
"""Messages of a few bytes that declare billions."""

import struct

import numpy as np
import pytest

from ceiling_dso_ros.io.bag_reader import RawMessage
from ceiling_dso_ros.io.errors import FrameError
from ceiling_dso_ros.io.message_lengths import check_lengths
from ceiling_dso_ros.io.message_writer import MessageWriter
from ceiling_dso_ros.io.ros_messages import TYPES

HEADER = struct.pack("<III", 0, 1, 2)  # without its frame


class Written(MessageWriter):
    def __init__(self):
        super().__init__()
        self.messages = []

    def write(self, topic, stamp_ns, content, latched=False):
        self.messages.append(content)


def messages():
    """One of each type that is read."""
    written = Written()
    T = np.eye(4)
    written.image("/a", 1, "camera", np.zeros((3, 4), np.uint8))
    written.compressed_image("/a", 1, "camera", b"1234", "png")
    written.camera_info("/a", 1, "camera", (4, 3), np.eye(3))
    written.exposure("/a", 1, "camera", 5.0)
    written.ticks("/a", 1, -7)
    written.joint_state("/a", 1, ["left", "right"], [1.0, 2.0])
    written.odometry("/a", 1, "odom", "base_link", T, (0, 0, 0), (0, 0, 0))
    written.pose("/a", 1, "vo", T)
    written.tf_static(1, [("a", "b", T), ("b", "c", T)])
    return written.messages


@pytest.mark.parametrize("message", messages(), ids=lambda message: message.__msgtype__)
def test_messages_have_the_length_that_they_declare(message):
    data = bytes(TYPES.serialize_ros1(message, message.__msgtype__))
    check_lengths(data, message.__msgtype__)
    for wrong in (data[:-1], data + b"\0", b""):
        with pytest.raises(ValueError, match=r"declares more than its|ends after"):
            check_lengths(wrong, message.__msgtype__)


@pytest.mark.parametrize(
    ("message_type", "data"),
    [
        # Each of the names has minus four bytes, so that the next one begins where it began.
        ("sensor_msgs/msg/JointState", HEADER + struct.pack("<IIi", 0, 2**31 - 1, -4) + bytes(12)),
        ("sensor_msgs/msg/JointState", HEADER + struct.pack("<II", 0, 2**32 - 1)),
        ("sensor_msgs/msg/JointState", HEADER + struct.pack("<i", -4)),
        ("tf2_msgs/msg/TFMessage", struct.pack("<I", 2**31 - 1) + HEADER + struct.pack("<i", -16)),
        ("sensor_msgs/msg/Image", HEADER + struct.pack("<IIIIBII", 0, 60000, 60000, 0, 0, 60000, 2**32 - 1)),
        ("sensor_msgs/msg/CompressedImage", HEADER + struct.pack("<III", 0, 0, 2**32 - 1)),
    ],
    ids=["names of negative length", "names", "a frame of negative length", "transforms", "image", "compressed image"],
)
def test_a_message_of_a_few_bytes_that_declares_gigabytes(message_type, data):
    with pytest.raises(ValueError, match="declares more than its"):
        check_lengths(data, message_type)
    with pytest.raises(FrameError, match=f"^damaged message of {len(data)} bytes$"):
        RawMessage("/a", 1, message_type, data).content()
