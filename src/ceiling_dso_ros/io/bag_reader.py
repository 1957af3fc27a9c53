# SPDX-License-Identifier: BSD-3-Clause
"""Streams messages from ROS 1 bags; any problem with a bag is reported as an InputError of one line."""

from contextlib import contextmanager
from itertools import chain, islice
from pathlib import Path
from typing import Iterator, List, NamedTuple, Sequence

from ceiling_dso_ros.io.bag_bounds import BoundedReader
from ceiling_dso_ros.io.errors import FrameError, InputError
from ceiling_dso_ros.io.message_lengths import check_lengths
from ceiling_dso_ros.io.ros_messages import TYPES, RosMessage

MAGIC = b"#ROSBAG V2.0\n"
IMAGE = "sensor_msgs/msg/Image"
OF_REALSENSE = "/image/data"  # how the topics of images end that the RealSense library records
DEPTH_UNIT_BYTES = 4  # that it adds to their end, though the type that it names has none


class RawMessage(NamedTuple):
    """A message as stored in the bag.

    Attributes:
        topic: its topic.
        stamp_ns: when it was recorded, nanoseconds.
        message_type: as in "sensor_msgs/msg/Image".
        data: serialised content.
    """

    topic: str
    stamp_ns: int
    message_type: str
    data: bytes

    def content(self) -> RosMessage:
        """The message itself.

        Raises:
            FrameError: the bytes are not those of such a message.
        """
        try:
            data = self._as_declared()
            return TYPES.deserialize_ros1(data, self.message_type)
        except Exception as error:  # damaged bytes end in errors of any kind
            raise FrameError(f"damaged message of {len(self.data)} bytes") from error

    def _as_declared(self) -> bytes:
        """The bytes that a message of this type has.

        Raises:
            ValueError: these are others.
        """
        try:
            check_lengths(self.data, self.message_type)
        except ValueError:
            if self.message_type != IMAGE or not self.topic.endswith(OF_REALSENSE):
                raise
            check_lengths(self.data[:-DEPTH_UNIT_BYTES], self.message_type)
            return self.data[:-DEPTH_UNIT_BYTES]
        return self.data


@contextmanager
def open_bag(path: Path) -> Iterator[BoundedReader]:
    """The bag's index and messages.

    Raises:
        InputError: the file is not a ROS 1 bag, is not indexed, or is damaged where the caller reads it.
    """
    try:
        with path.open("rb") as file:
            magic = file.read(len(MAGIC))
    except OSError as error:
        raise InputError(f"{path}: cannot read the bag: {error.strerror}") from error
    if magic != MAGIC:
        raise InputError(f"{path}: is not a ROS 1 bag (format 2.0)")
    try:
        with BoundedReader(path) as reader:
            yield reader
    except (InputError, FrameError):
        raise
    except Exception as error:  # rosbags raises errors of any kind for damaged bytes
        raise InputError(
            f"{path}: the bag is not indexed or damaged ({str(error) or type(error).__name__}); "
            "'rosbag reindex' may repair it"
        ) from error


def read_messages(path: Path, topics: Sequence[str]) -> Iterator[RawMessage]:
    """All messages of some topics in the order of their recording, one at a time.

    Raises:
        InputError: the bag cannot be read on.
    """
    with open_bag(path) as reader:
        connections = [connection for connection in reader.connections if connection.topic in topics]
        if connections:  # none would mean all
            for connection, stamp_ns, data in reader.messages(connections):
                yield RawMessage(connection.topic, stamp_ns, connection.msgtype, data)


def read_first_and_last(path: Path, topic: str, count: int) -> List[RawMessage]:
    """The first messages of a topic, up to a number, and the last one, without those between; none if there are none.

    Raises:
        InputError: the bag cannot be read there.
    """
    with open_bag(path) as reader:
        connections = [each for each in reader.connections if each.topic == topic and reader.indexes[each.id]]
        if not connections:
            return []
        last_ns = max(reader.indexes[connection.id][-1].time for connection in connections)
        messages = chain(islice(reader.messages(connections), count), reader.messages(connections, start=last_ns))
        return [RawMessage(each.topic, stamp_ns, each.msgtype, data) for each, stamp_ns, data in messages]
