# SPDX-License-Identifier: BSD-3-Clause
"""Writes ROS 1 bags message by message, as `rosbag record` would."""

import os
import struct
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Dict, NamedTuple, Optional, Type, Union, cast

from rosbags.interfaces import Connection
from rosbags.rosbag1 import Writer

from ceiling_dso_ros.io.errors import OutputError, reason_of
from ceiling_dso_ros.io.interrupts import deferred_interrupt
from ceiling_dso_ros.io.message_writer import MessageWriter
from ceiling_dso_ros.io.ros_messages import TYPES, RosMessage

HEADER_GAP = 8  # bytes, see _lengthen_bag_header


class SerializedMessage(NamedTuple):
    """A message of any type, as ROS transports it.

    Attributes:
        topic: its topic.
        stamp_ns: when it was received, nanoseconds.
        message_type: as in "sensor_msgs/JointState".
        definition: the text of the type.
        md5sum: its checksum, which ROS compares.
        data: the message.
        latched: later subscribers get it too.
    """

    topic: str
    stamp_ns: int
    message_type: str
    definition: str
    md5sum: str
    data: bytes
    latched: bool


class BagWriter(MessageWriter):
    """A ROS 1 bag that grows with every call; a context manager.

    Like `rosbag record` it writes to `<path>.active` and renames that when it is closed, also after an exception or
    Ctrl-C. So a bag with its final name is complete and indexed. An existing bag is replaced.

    Raises:
        OutputError: the file cannot be written, from the constructor or any method.
    """

    def __init__(self, path: Union[str, Path]) -> None:
        super().__init__()
        self.path = Path(path)
        self._active = self.path.with_name(self.path.name + ".active")
        self._connections: Dict[str, Connection] = {}
        try:
            self._active.unlink(missing_ok=True)
            self._writer = Writer(self._active)
            self._writer.open()
            self._file = cast(BinaryIO, self._writer.bio)  # there since `open`
            self._file.write(b" " * HEADER_GAP)
            self._file.flush()
            _lengthen_bag_header(self._active)
        except OSError as error:
            raise OutputError(f"{self.path}: cannot write the bag: {reason_of(error)}") from error

    def __enter__(self) -> "BagWriter":
        return self

    def __exit__(
        self, kind: Optional[Type[BaseException]], error: Optional[BaseException], trace: Optional[TracebackType]
    ) -> None:
        if self._file.closed:  # abandoned
            return
        try:
            with deferred_interrupt():
                self._writer.close()
                _lengthen_bag_header(self._active)
                self._active.replace(self.path)
        except OSError as failure:
            self._abandon(failure)

    def write(self, topic: str, stamp_ns: int, content: RosMessage, latched: bool = False) -> None:
        """See MessageWriter."""
        try:
            connection = self._connections.get(topic)
            if connection is None:
                connection = self._writer.add_connection(
                    topic, content.__msgtype__, typestore=TYPES, latching=1 if latched else None
                )
                self._connections[topic] = connection
            data = TYPES.serialize_ros1(content, content.__msgtype__)
            self._append(connection, stamp_ns, bytes(data))
        except OSError as error:
            self._abandon(error)

    def write_serialized(self, message: SerializedMessage) -> None:
        """Write a message of a type that need not be known."""
        try:
            connection = self._connections.get(message.topic)
            if connection is None:
                package, name = message.message_type.split("/")
                connection = self._writer.add_connection(
                    message.topic,
                    f"{package}/msg/{name}",
                    msgdef=message.definition,
                    md5sum=message.md5sum,
                    latching=1 if message.latched else None,
                )
                self._connections[message.topic] = connection
            self._append(connection, message.stamp_ns, message.data)
        except OSError as error:
            self._abandon(error)

    def _append(self, connection: Connection, stamp_ns: int, data: bytes) -> None:
        with deferred_interrupt():
            self._writer.write(connection, stamp_ns, data)

    def _abandon(self, error: OSError) -> None:
        """Remove the unfinished bag, which cannot be used without its index."""
        with suppress(OSError):  # the rest of the buffer does not fit on the disk either
            self._file.close()
        self._active.unlink(missing_ok=True)
        raise OutputError(f"{self.path}: cannot write the bag, it was removed: {reason_of(error)}") from error


def _lengthen_bag_header(path: Path) -> None:
    """Give the padding of the bag's first record the length that ROS expects.

    ROS pads header and data to 4096 bytes, rosbags the record with its two length fields. With the shorter record
    `rosbag reindex` would write over the first chunk.
    """
    with path.open("r+b") as file:
        file.seek(len(b"#ROSBAG V2.0\n"))
        (header_length,) = struct.unpack("<L", file.read(4))
        file.seek(header_length, os.SEEK_CUR)
        file.write(struct.pack("<L", 4096 - header_length))
