# SPDX-License-Identifier: BSD-3-Clause
"""Parts of small bags for the tests of their reader."""

import numpy as np

from ceiling_dso_ros.io.ros_messages import TYPES

START_NS, PERIOD_NS = 1_700_000_001_030_042_017, 33_333_333
WIDTH, HEIGHT = 96, 80
K = np.array([[60.0, 0, 47.5], [0, 61.0, 39.5], [0, 0, 1]])
IMAGE, INFO, EXPOSURE = "/camera/up/image_raw", "/camera/up/camera_info", "/camera/up/exposure"


def stamp_ns(index):
    return START_NS + index * PERIOD_NS


def picture(index=0, dtype=np.uint8):
    x, y = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    grey = (2 + np.sin((x + 3 * index) / 5) + np.cos(y / 7)) / 4
    return (grey * np.iinfo(dtype).max).astype(dtype)


def write_images(bag, indices=range(4), topic=IMAGE):
    for index in indices:
        bag.image(topic, stamp_ns(index), "optical", picture(index))


def write_info(bag, topic=INFO, **changes):
    bag.camera_info(topic, START_NS, "optical", **{"size": (WIDTH, HEIGHT), "K": K, **changes})


def write_damaged(bag, topic, type_name, data=b"\x01\x02\x03"):
    """A message of a topic that has none yet, or has been written to before, that cannot be deserialised."""
    connection = bag._connections.get(topic) or bag._writer.add_connection(topic, type_name, typestore=TYPES)
    bag._connections[topic] = connection
    bag._writer.write(connection, stamp_ns(9), data)
