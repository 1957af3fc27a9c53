# SPDX-License-Identifier: BSD-3-Clause
"""Targets that read bags: with other bytes, other fields of messages, and messages that declare other lengths."""

from functools import lru_cache
from pathlib import Path
from random import Random
from typing import Callable, Dict, List, Optional, Sequence, Tuple

from rosbags.interfaces import Connection
from rosbags.rosbag1 import Writer
from support.fuzzing import mutations
from support.fuzzing.messages import mutated_lengths, mutated_message, serialised
from support.fuzzing.recordings import drive_messages, read_all
from support.fuzzing.rules import USED, outcome_of
from support.fuzzing.runner import Case, Target

from ceiling_dso_ros.io.bag_trajectories import read_trajectories
from ceiling_dso_ros.io.opening import open_recording
from ceiling_dso_ros.io.recording import TopicNames
from ceiling_dso_ros.io.ros_messages import TYPES

LATEST_NS = (2**32 - 1) * 10**9  # that a bag can hold

ROBOT = "ticks_per_turn: 4096\nwheel_radius: [0.1, 0.1]\nwheel_base: 0.5\n"  # its camera's pose is that of tf
TRAJECTORIES = {"camera": "/visual_odometry/pose", "wheel": "/odom", "fused": "/odometry/filtered"}
IMAGES = ("/camera/up/image_raw", "/camera/small/image_raw", "/device_0/sensor_0/Infrared_1/image/data")
COMPRESSIONS = (None, None, Writer.CompressionFormat.BZ2, Writer.CompressionFormat.LZ4)

# Topic, stamp_ns of the record, type and bytes of a message.
Record = Tuple[str, int, str, bytes]


def targets(folder: Path) -> List[Target]:
    """All of them; they write to a folder."""
    (folder / "fuzzed.robot.yaml").write_text(ROBOT)
    path = folder / "fuzzed.bag"
    messages = drive_messages().all
    records = [(topic, stamp_ns, each.__msgtype__, serialised(each)) for topic, stamp_ns, each in messages]
    whole = []
    for compression in COMPRESSIONS[1:]:
        write_bag(path, records, compression)
        whole.append(path.read_bytes())

    def bytes_of_bag(random: Random) -> Case:
        content = random.choice(whole)
        # Between them is mostly what images look like.
        place = random.choice((slice(0, 4600), slice(len(content) - 6000, len(content)), slice(0, len(content))))
        content = content[: place.start] + mutations.mutated_bytes(random, content[place]) + content[place.stop :]
        return _reading(random, path, lambda: path.write_bytes(content), content)

    def fields_of_messages(random: Random) -> Case:
        changed = list(messages)
        for _ in range(1 + random.randrange(5)):
            at = random.randrange(len(changed))
            topic, stamp_ns, message = changed[at]
            changed[at] = topic, _stamp(random, stamp_ns), mutated_message(random, message)
        content = [(topic, stamp_ns, each.__msgtype__, serialised(each)) for topic, stamp_ns, each in changed]
        different = [each for each, before in zip(changed, messages) if each is not before]
        compression = random.choice(COMPRESSIONS)
        return _reading(random, path, lambda: write_bag(path, content, compression), different)

    def lengths_in_messages(random: Random) -> Case:
        content = list(records)
        for _ in range(1 + random.randrange(3)):
            at = random.randrange(len(content))
            topic, stamp_ns, message_type, _ = content[at]
            content[at] = topic, stamp_ns, message_type, mutated_lengths(random, messages[at][2])
        return _reading(
            random, path, lambda: write_bag(path, content, None), [each for each in content if each not in records]
        )

    return [
        Target("bag, bytes", 1500, lambda: bytes_of_bag),
        Target("bag, fields of messages", 1500, lambda: fields_of_messages),
        Target("bag, bytes of messages", 700, lambda: lengths_in_messages),
    ]


def write_bag(path: Path, records: Sequence[Record], compression: Optional[Writer.CompressionFormat]) -> None:
    """Write a bag with these messages."""
    path.unlink(missing_ok=True)
    connections: Dict[str, Connection] = {}
    writer = Writer(path)
    if compression is not None:
        writer.set_compression(compression)
    with writer:
        for topic, stamp_ns, message_type, data in records:
            if topic not in connections:
                definition, digest = _definition(message_type)
                connections[topic] = writer.add_connection(topic, message_type, msgdef=definition, md5sum=digest)
            writer.write(connections[topic], min(max(stamp_ns, 0), LATEST_NS), data)


@lru_cache(maxsize=None)
def _definition(message_type: str) -> Tuple[str, str]:
    return TYPES.generate_msgdef(message_type)


def _reading(random: Random, path: Path, write: Callable[[], object], shown: object) -> Case:
    """Write a bag, and read all that is read of bags, each whatever becomes of the others."""
    topics = TopicNames(
        image=random.choice(IMAGES), wheel_input=random.choice(("", "", "ticks", "joint_states", "odometry")),
        camera_info="/camera/up/camera_info",
    )  # fmt: skip
    rectified = not random.randrange(4)
    said: List[str] = []

    def act() -> str:
        write()
        outcome = outcome_of(lambda: read_all(open_recording(path, topics, rectified=rectified, warn=said.append)))
        others = outcome_of(lambda: read_trajectories(path, TRAJECTORIES, said.append))
        return USED if USED in (outcome, others) else outcome

    return (topics, shown), act


def _stamp(random: Random, stamp_ns: int) -> int:
    return stamp_ns if random.randrange(3) else random.choice((1, stamp_ns - 10**9, stamp_ns + 10**12, LATEST_NS))
