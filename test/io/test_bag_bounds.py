# SPDX-License-Identifier: BSD-3-Clause
"""Bags that declare more than they have, and chunks that become gigabytes."""

import re
import struct

import numpy as np
import pytest
from rosbags.rosbag1 import Writer

from ceiling_dso_ros.io import bag_bounds
from ceiling_dso_ros.io.bag_reader import open_bag, read_messages
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.ros_messages import TYPES, header, message

TOPIC = "/image"
FORMATS = [Writer.CompressionFormat.BZ2, Writer.CompressionFormat.LZ4]


def write(path, compression=None, pixels=1000, count=2):
    writer = Writer(path)
    if compression is not None:
        writer.set_compression(compression)
    fields = {"height": 1, "width": pixels, "encoding": "mono8", "is_bigendian": 0, "step": pixels}
    with writer:
        connection = writer.add_connection(TOPIC, "sensor_msgs/msg/Image", typestore=TYPES)
        for index in range(count):
            image = message(
                "sensor_msgs/Image", header=header(1 + index, "a"), data=np.zeros(pixels, np.uint8), **fields
            )
            writer.write(connection, 1 + index, TYPES.serialize_ros1(image, image.__msgtype__))
    return path


@pytest.mark.parametrize("compression", [None, *FORMATS])
def test_bags_are_read(tmp_path, compression):
    read = list(read_messages(write(tmp_path / "a.bag", compression), [TOPIC]))
    assert [raw.stamp_ns for raw in read] == [1, 2]
    assert len(read[0].content().data) == 1000


@pytest.mark.parametrize("compression", FORMATS)
def test_a_chunk_that_becomes_too_large_is_not_decompressed(tmp_path, monkeypatch, compression):
    path = write(tmp_path / "a.bag", compression, pixels=4_000_000)
    assert path.stat().st_size < 40_000
    monkeypatch.setattr(bag_bounds, "MOST_CHUNK_BYTES", 1_000_000)
    with pytest.raises(
        InputError, match=re.escape(f"{path}: the bag is not indexed or damaged (a compressed chunk has")
    ):
        list(read_messages(path, [TOPIC]))


@pytest.mark.parametrize("place", ["bag header", "chunk", "index"])
def test_a_record_that_declares_four_gigabytes(tmp_path, place):
    path = write(tmp_path / "a.bag")
    content = bytearray(path.read_bytes())
    at = {"bag header": 13, "chunk": content.index(b"compression=none") + 16, "index": content.rindex(b"ver=") - 8}[
        place
    ]
    if place == "chunk":  # its size follows a further field
        at = content.index(b"size=") + 9
    struct.pack_into("<I", content, at, 2**32 - 16)
    path.write_bytes(bytes(content))
    with pytest.raises(InputError, match=re.escape(f"{path}: the bag is not indexed or damaged")):
        list(read_messages(path, [TOPIC]))


def test_chunks_that_share_an_index(tmp_path):
    """Each further one is a record of 80 bytes, and would add all messages of the first."""
    path = write(tmp_path / "a.bag", count=2000, pixels=1)
    content = bytearray(path.read_bytes())
    start = struct.unpack_from("<Q", content, content.index(b"index_pos=") + 10)[0]
    while content[start:]:
        info = content[start:]  # the last record
        (header_length,) = struct.unpack_from("<I", content, start)
        start += 8 + header_length + struct.unpack_from("<I", content, start + 4 + header_length)[0]
    at = content.index(b"chunk_count=") + 12
    (chunks,) = struct.unpack_from("<I", content, at)
    struct.pack_into("<I", content, at, chunks + 50)
    path.write_bytes(content + 50 * info)
    with pytest.raises(InputError, match="chunks share their index"), open_bag(path):
        pass
