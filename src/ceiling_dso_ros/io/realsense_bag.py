# SPDX-License-Identifier: BSD-3-Clause
"""Recordings of realsense-viewer and of the library's recorder: ROS 1 bags with topics of their own."""

import re
from bisect import bisect_left
from collections import defaultdict
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Callable, Dict, List, Optional, Tuple

from ceiling_dso_ros.io.bag import BagRecording, Moment
from ceiling_dso_ros.io.bag_reader import RawMessage, open_bag, read_messages
from ceiling_dso_ros.io.errors import FrameError
from ceiling_dso_ros.io.realsense_metadata import LONGEST_MS
from ceiling_dso_ros.io.recording import ImageTimes, TopicNames
from ceiling_dso_ros.io.ros_messages import RosMessage, header_stamp_ns
from ceiling_dso_ros.io.warning_log import ignore_warning

IMAGES = re.compile(r"(/device_\d+/sensor_\d+/[^/]+)/image/data")
LEFT_IMAGES = re.compile(r"/device_\d+/sensor_\d+/Infrared_1/image/data")
EMITTER = re.compile(r"/device_\d+/sensor_\d+/option/Emitter[_ ]Enabled/value")
COUNTER_US = 2**32  # the camera counts microseconds in 32 bits
# Names of the metadata of an image.
EXPOSURE, READOUT, MIDDLE, DOMAIN = "Actual Exposure", "Frame Timestamp", "Sensor Timestamp", "timestamp_domain"
HARDWARE_CLOCK = "Hardware Clock"
DISTANCE_NS = 10**6  # metadata are recorded with their image


def realsense_topics(path: Path, topics: TopicNames) -> Optional[TopicNames]:
    """The topics of a recording of realsense-viewer; None if the bag is another one.

    Args:
        path: of a bag.
        topics: as asked for; instead of the default images, the left infrared ones are taken.

    Raises:
        InputError: the bag cannot be read.
    """
    with open_bag(path) as reader:
        known = {connection.topic for connection in reader.connections}
    is_default = topics.image == TopicNames.image and topics.image not in known
    found = sorted(filter(LEFT_IMAGES.fullmatch, known)) if is_default else [topics.image]
    match = IMAGES.fullmatch(found[0]) if found else None
    if match is None:
        return None
    info = topics.camera_info or f"{match[1]}/info/camera_info"
    topics = replace(topics, image=found[0], camera_info=info)
    right = found[0].replace("Infrared_1", "Infrared_2")
    if topics.right_image != TopicNames.right_image or right == found[0] or right not in known:
        return topics
    return replace(topics, right_image=right, right_camera_info=right.replace("/image/data", "/info/camera_info"))


class RealsenseRecording(BagRecording):
    """A recording of one camera.

    Stamps are those of the middle of the exposure, as the camera's clock tells them: it has no jumps, unlike the
    library's time. The first one is that of the recording.
    """

    def __init__(
        self,
        path: Path,
        topics: TopicNames,
        camera_file: Optional[Path] = None,
        robot_file: Optional[Path] = None,
        rectified: bool = False,
        warn: Callable[[str], None] = ignore_warning,
    ) -> None:
        """See `BagRecording`; the topics are those of `realsense_topics`."""
        super().__init__(path, topics, camera_file, robot_file, rectified, warn)
        self._warn_of_emitter()

    def image_times(self) -> Optional[ImageTimes]:
        """See Recording; times of recording begin with zero, so that delays are unknown."""
        times = super().image_times()
        return None if times is None else replace(times, delay_ns=None)

    def _moments(self) -> Callable[[RawMessage, RosMessage], Moment]:
        metadata = self._read_metadata()
        if metadata and not any(EXPOSURE in fields for fields in metadata.values()):
            self._warn(
                f"{self.path}: has no exposure times: the kernel of the recording computer does not pass on metadata"
            )
        clock = _CameraClock()
        recorded_ns = sorted(metadata)

        def moment_of(raw: RawMessage, image: RosMessage) -> Moment:
            nearest_ns = _nearest(recorded_ns, raw.stamp_ns)
            fields = {} if nearest_ns is None else metadata[nearest_ns]
            return clock.stamp_ns(header_stamp_ns(image.header), fields), _exposure_ms(fields)

        return moment_of

    def _read_metadata(self) -> Dict[int, Dict[str, str]]:
        """What is needed of them, by the time of recording in nanoseconds."""
        found: Dict[int, Dict[str, str]] = defaultdict(dict)
        topic = self._topics.image[: -len("data")] + "metadata"
        for _, stamp_ns, entry in self._contents.read("diagnostic_msgs/msg/KeyValue", topic):
            if entry.key in (EXPOSURE, READOUT, MIDDLE, DOMAIN):
                found[stamp_ns][entry.key] = entry.value
        return found

    def _warn_of_emitter(self) -> None:
        topics = [topic for topic in self._types if EMITTER.fullmatch(topic)]
        for raw in read_messages(self.path, topics):
            with suppress(FrameError):
                if raw.content().data > 0.0:
                    self._warn(f"{self.path}: the emitter is on: its dots move with the robot; switch it off")
                    return


def _nearest(recorded_ns: List[int], stamp_ns: int) -> Optional[int]:
    index = bisect_left(recorded_ns, stamp_ns - DISTANCE_NS)
    near = [time_ns for time_ns in recorded_ns[index : index + 3] if time_ns <= stamp_ns + DISTANCE_NS]
    return min(near, key=lambda time_ns: abs(time_ns - stamp_ns)) if near else None


def _number(fields: Dict[str, str], name: str) -> Optional[int]:
    text = fields.get(name, "")
    return int(text) if text.isascii() and text.isdigit() and len(text) < 20 else None


def _exposure_ms(fields: Dict[str, str]) -> Optional[float]:
    exposure_us = _number(fields, EXPOSURE)
    return exposure_us / 1e3 if exposure_us and exposure_us <= 1e3 * LONGEST_MS else None


class _CameraClock:
    """Stamps in the middle of the exposure that go on where the camera's counter wraps around."""

    def __init__(self) -> None:
        self._last: Optional[Tuple[int, int]] = None  # counter in microseconds, its stamp in nanoseconds

    def stamp_ns(self, readout_ns: int, fields: Dict[str, str]) -> int:
        """The stamp of an image that the library stamps with the start of its readout, and with these metadata."""
        middle_us: Optional[int] = _number(fields, MIDDLE)
        readout_us = _number(fields, READOUT)
        exposure_ms = _exposure_ms(fields)
        before_us = round(500.0 * exposure_ms) if exposure_ms is not None else 0
        if middle_us is not None and readout_us is not None:
            measured_us = (readout_us - middle_us) % COUNTER_US
            before_us = measured_us if measured_us <= 1e3 * LONGEST_MS else before_us
        plain_ns = readout_ns - 1000 * before_us
        if middle_us is None and readout_us is not None:
            middle_us = (readout_us - before_us) % COUNTER_US
        if middle_us is None and fields.get(DOMAIN) == HARDWARE_CLOCK:
            middle_us = plain_ns // 1000 % COUNTER_US
        if middle_us is None:
            return plain_ns
        if self._last is None:
            stamp_ns = 1000 * round(plain_ns / 1000)  # as the camera counts; the rest is rounding of the library
        else:
            last_us, last_ns = self._last
            step_us = (middle_us - last_us + COUNTER_US // 2) % COUNTER_US - COUNTER_US // 2
            stamp_ns = last_ns + 1000 * step_us
        self._last = middle_us, stamp_ns
        return stamp_ns
