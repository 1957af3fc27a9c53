# SPDX-License-Identifier: BSD-3-Clause
"""Exposure times of the images: of this package's own messages, or of those of Intel's driver realsense-ros."""

import math
import struct
from typing import List, Optional, Tuple

import rospy

from ceiling_dso_ros.io.realsense_metadata import exposure_in_metadata
from ceiling_dso_ros.msg import Exposure
from ceiling_dso_ros.ros.exposures import ExposureLookup

QUEUE_SIZE = 50
TIMEOUT_S = 0.05
# The driver's package is not needed to read its messages.
METADATA_TYPE = "realsense2_camera/Metadata"
STAMP, LENGTH = struct.Struct("<III"), struct.Struct("<I")  # of a header: seq, seconds, nanoseconds; of a text


class ExposureInput:
    """The topics `exposure` (ceiling_dso_ros/Exposure) and `metadata` (realsense2_camera/Metadata), both optional."""

    def __init__(self) -> None:
        self._lookup = ExposureLookup()
        self._subscribers = {
            "exposure": rospy.Subscriber("exposure", Exposure, self._on_exposure, queue_size=QUEUE_SIZE),
            "metadata": rospy.Subscriber("metadata", rospy.AnyMsg, self._on_metadata, queue_size=QUEUE_SIZE),
        }

    @property
    def complaint(self) -> str:
        """What is wrong with them; empty if nothing is."""
        topics = [rospy.resolve_name(topic) for topic in self._connected()]
        if not topics or not self._lookup.is_late:
            return ""
        verb, them = ("comes", "it") if len(topics) == 1 else ("come", "them")
        return f"{' and '.join(topics)} {verb} too late or not at all: images do not wait for {them}"

    def at(self, stamp_ns: int) -> Optional[float]:
        """Exposure in ms of the image with this stamp, which may be waited for; None when it is unknown."""
        return self._lookup.at(stamp_ns, TIMEOUT_S if self._connected() else 0.0)

    def _connected(self) -> List[str]:
        return [topic for topic, subscriber in self._subscribers.items() if subscriber.get_num_connections() > 0]

    def _on_exposure(self, message: Exposure) -> None:
        known = 0.0 < message.exposure_ms < math.inf
        self._lookup.add(message.header.stamp.to_nsec(), message.exposure_ms if known else None)

    def _on_metadata(self, message: rospy.AnyMsg) -> None:
        kind = message._connection_header.get("type")
        if kind != METADATA_TYPE:
            rospy.logwarn_once(f"{rospy.resolve_name('metadata')} is not used: it holds {kind}, no {METADATA_TYPE}")
            return
        try:
            stamp_ns, json_data = stamped_text(message._buff)
        except (struct.error, UnicodeDecodeError):
            rospy.logwarn_once(f"{rospy.resolve_name('metadata')}: a damaged message is not used")
            return
        self._lookup.add(stamp_ns, exposure_in_metadata(json_data))


def stamped_text(data: bytes) -> Tuple[int, str]:
    """Stamp in nanoseconds and text of a serialised message with a header and a string.

    Raises:
        struct.error, UnicodeDecodeError: the bytes are not those of such a message.
    """
    _, secs, nsecs = STAMP.unpack_from(data)
    (frame_length,) = LENGTH.unpack_from(data, STAMP.size)
    start = STAMP.size + LENGTH.size + frame_length
    (text_length,) = LENGTH.unpack_from(data, start)
    text = data[start + LENGTH.size : start + LENGTH.size + text_length]
    return secs * 1_000_000_000 + nsecs, text.decode("utf-8")
