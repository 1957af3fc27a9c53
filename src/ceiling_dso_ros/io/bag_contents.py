# SPDX-License-Identifier: BSD-3-Clause
"""What a bag contains: its topics, their messages, and the frames of tf."""

from pathlib import Path
from typing import Dict, Iterator, List, Optional, Tuple

import numpy as np

from ceiling_dso_ros.io.bag_reader import open_bag, read_messages
from ceiling_dso_ros.io.errors import FrameError, InputError
from ceiling_dso_ros.io.ros_messages import RosMessage
from ceiling_dso_ros.io.static_transforms import StaticTransforms

TF = "tf2_msgs/msg/TFMessage"


class BagContents:
    """Reads the messages of one bag by their topics.

    Attributes:
        path: of the bag.
        types: topic -> type of its messages.
        counts: topic -> number of its messages.
    """

    def __init__(self, path: Path) -> None:
        """Read the index.

        Raises:
            InputError: the bag cannot be read.
        """
        self.path = path
        with open_bag(path) as reader:
            connections = reader.connections
        self.types: Dict[str, str] = {connection.topic: connection.msgtype for connection in connections}
        self.counts: Dict[str, int] = {}
        for connection in connections:
            self.counts[connection.topic] = self.counts.get(connection.topic, 0) + connection.msgcount

    def of_type(self, *message_types: str) -> List[str]:
        """The topics that hold messages of one of these types, sorted."""
        return sorted(topic for topic, message_type in self.types.items() if message_type in message_types)

    def read(self, message_type: str, *topics: str) -> Iterator[Tuple[str, int, RosMessage]]:
        """(topic, stamp_ns of the record, message) of all messages of some topics, none if they are not in the bag.

        Raises:
            InputError: a topic holds messages of another type, or a message is damaged.
        """
        for topic in topics:
            if self.types.get(topic, message_type) != message_type:
                raise InputError(f"{self.path}: topic {topic} holds {self.types[topic]} instead of {message_type}")
        for raw in read_messages(self.path, topics):
            try:
                yield raw.topic, raw.stamp_ns, raw.content()
            except FrameError as error:
                raise InputError(f"{self.path}, {raw.topic}: {error}; leave the topic out or repair the bag") from error

    def find_transform(self, target: str, source: str) -> Tuple[Optional[np.ndarray], List[str]]:
        """T_target_source (4, 4) from /tf_static, or from /tf as it first is there; None if they are not connected.

        The second result are the frames that were found until then.

        Raises:
            InputError: a message is damaged.
        """
        transforms = StaticTransforms(message for _, _, message in self.read(TF, "/tf_static"))
        found = transforms.lookup(target, source)
        moving = self.read(TF, "/tf")
        while found is None:
            message = next(moving, None)
            if message is None:
                break
            transforms.add(message[2])
            found = transforms.lookup(target, source)
        return found, transforms.frames
