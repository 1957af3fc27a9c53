# SPDX-License-Identifier: BSD-3-Clause
"""Recordings in ROS 1 bags, read without ROS."""

from contextlib import suppress
from functools import cached_property, partial
from itertools import islice
from pathlib import Path
from statistics import median_low
from typing import Any, Callable, Dict, Iterator, List, Optional, Tuple

import numpy as np

from ceiling_dso_ros.io.bag_contents import BagContents
from ceiling_dso_ros.io.bag_reader import RawMessage, read_first_and_last, read_messages
from ceiling_dso_ros.io.bag_wheels import BagWheels
from ceiling_dso_ros.io.camera_info import (
    calibration_from_camera_info,
    camera_info_fields,
    distorted_though_rectified,
)
from ceiling_dso_ros.io.camera_models import CameraCalibration, read_camera_file
from ceiling_dso_ros.io.errors import FrameError, InputError
from ceiling_dso_ros.io.image_decoding import decode_compressed, decode_image
from ceiling_dso_ros.io.photometric import PhotometricCalibration
from ceiling_dso_ros.io.realsense_metadata import TYPE as METADATA
from ceiling_dso_ros.io.realsense_metadata import exposure_in_metadata
from ceiling_dso_ros.io.recording import (
    ImageTimes,
    ListedImage,
    Recording,
    RobotDescription,
    SecondCamera,
    TopicNames,
    WheelSamples,
)
from ceiling_dso_ros.io.robot_file import read_robot_file
from ceiling_dso_ros.io.ros_messages import RosMessage, header_stamp_ns
from ceiling_dso_ros.io.second_camera import SecondCameraInBag
from ceiling_dso_ros.io.stamps import format_stamp
from ceiling_dso_ros.io.warning_log import ignore_warning

LONGEST_DELAY_NS = 60 * 10**9  # between the stamp and the record of an image, beyond the usual: else the stamp is wrong
TIMED_IMAGES = 20
Moment = Tuple[int, Optional[float]]  # stamp in nanoseconds, exposure time in milliseconds

DECODERS: Dict[str, Callable[[RosMessage], np.ndarray]] = {
    "sensor_msgs/msg/Image": lambda image: decode_image(
        image.encoding, image.height, image.width, image.step, image.is_bigendian, image.data
    ),
    "sensor_msgs/msg/CompressedImage": lambda image: decode_compressed(image.data, image.format),
}
MOST_CALIBRATIONS = 100  # different ones that are looked at: each takes up to a tenth of a second
FIRST_IMAGES = 10  # that are tried for the size of all


class BagRecording(Recording):
    """A ROS 1 bag, read message by message; only exposures and wheel data are held in memory.

    The files `tour.robot.yaml` and `tour.groundtruth.tum` beside `tour.bag` are optional.
    """

    def __init__(
        self,
        path: Path,
        topics: TopicNames = TopicNames(),
        camera_file: Optional[Path] = None,
        robot_file: Optional[Path] = None,
        rectified: bool = False,
        warn: Callable[[str], None] = ignore_warning,
    ) -> None:
        """Open the bag and find the images and their calibration; see `open_recording`.

        Raises:
            InputError: the bag cannot be read, or what is needed is not in it.
        """
        self.path = path
        self._topics = topics
        self._robot_file = robot_file or self._beside(".robot.yaml")
        self._rectified = rectified
        self._warn = warn
        self._contents = BagContents(path)
        self._types = self._contents.types
        self._image_topic = self._find_image_topic()
        self._length = self._contents.counts[self._image_topic]
        self._info_topic = topics.camera_info or topics.beside_image("camera_info") if camera_file is None else None
        self._image_size = self._read_image_size()
        self.calibration = self._read_camera_info() if camera_file is None else read_camera_file(camera_file)
        self.photometric = PhotometricCalibration.linear()
        self._second = SecondCameraInBag(self._contents, topics, DECODERS, self._image_topic, rectified, warn)

    def __len__(self) -> int:
        return self._length

    def images(self) -> Iterator[ListedImage]:
        """See Recording."""
        moment_of = self._moments()
        decode = DECODERS[self._types[self._image_topic]]
        paired = None if self.second_camera is None else self._second.images()
        for number, raw in enumerate(self._image_messages(), start=1):
            name = f"{self.path}, {self._image_topic}, message {number}"
            try:
                image = raw.content()
            except FrameError:
                yield ListedImage(None, None, name, raw.content)
                continue
            stamp_ns, exposure_ms = moment_of(raw, image)
            right = None if paired is None else paired.at(header_stamp_ns(image.header), raw.stamp_ns)
            yield ListedImage(stamp_ns, exposure_ms, name, partial(decode, image), raw.stamp_ns, right)

    def image_times(self) -> Optional[ImageTimes]:
        """See Recording; of a number of images, because all of them would take long to read."""
        stamps_ns: List[int] = []
        delays_ns: List[int] = []
        for raw in read_first_and_last(self.path, self._image_topic, TIMED_IMAGES):
            with suppress(FrameError):
                stamps_ns.append(header_stamp_ns(raw.content().header))
                delays_ns.append(raw.stamp_ns - stamps_ns[-1])
        if not stamps_ns:
            return None
        delay_ns = median_low(delays_ns)  # that of an image
        usual = [stamp for stamp, delay in zip(stamps_ns, delays_ns) if abs(delay - delay_ns) <= LONGEST_DELAY_NS]
        return ImageTimes(min(usual), max(usual), delay_ns)

    @cached_property
    def second_camera(self) -> Optional[SecondCamera]:
        """See Recording."""
        return self._second.camera()

    @cached_property
    def wheels(self) -> Optional[WheelSamples]:
        """See Recording and `BagWheels`."""
        return BagWheels(self.path, self._types, self._topics, self._contents.read, self._warn).read()

    @cached_property
    def robot(self) -> Optional[RobotDescription]:
        """See Recording; T_base_camera comes from tf unless the robot file has it."""
        if self._robot_file is None:
            return None
        from_tf: List[np.ndarray] = []

        def find_mount() -> np.ndarray:
            from_tf.append(self._find_mount())
            return from_tf[0]

        robot = read_robot_file(self._robot_file, find_mount)
        if self._topics.camera_frame and not from_tf:
            self._warn(
                f"{self._robot_file}: its T_base_camera is used, and not the pose of {self._topics.camera_frame} in "
                "tf; take T_base_camera out of it to use that"
            )
        return robot

    @property
    def ground_truth_path(self) -> Optional[Path]:
        """See Recording."""
        return self._beside(".groundtruth.tum")

    def _beside(self, ending: str) -> Optional[Path]:
        path = self.path.with_name(self.path.stem + ending)
        return path if path.exists() else None

    def _find_image_topic(self) -> str:
        wanted = self._topics.image
        for topic in (wanted, f"{wanted}/compressed"):
            if self._types.get(topic) in DECODERS:
                return topic
        problem = f"holds {self._types[wanted]}, no images" if wanted in self._types else "is not in the bag"
        topics = sorted(topic for topic, message_type in self._types.items() if message_type in DECODERS)
        remedy = f"choose with --image-topic: it has {', '.join(topics)}" if topics else "it has no images at all"
        raise InputError(f"{self.path}: topic {wanted} {problem}; {remedy}")

    def _image_messages(self) -> Iterator[RawMessage]:
        """All messages with images; a camera_info in between that describes another camera is warned of."""
        known = self.calibration
        fields: Dict[str, Any] = {}
        changes = 0
        for raw in read_messages(self.path, [topic for topic in (self._image_topic, self._info_topic) if topic]):
            if raw.topic == self._image_topic:
                yield raw
                continue
            with suppress(FrameError, InputError):
                info = raw.content()
                if changes == MOST_CALIBRATIONS or camera_info_fields(info) == fields:
                    continue
                fields = camera_info_fields(info)
                changes += 1
                calibration = self._calibration_of(info)
                if calibration != known:
                    self._warn(
                        f"{self.path}, {raw.topic}: camera_info changes at {format_stamp(raw.stamp_ns)} to "
                        f"{calibration.lens}; all images are taken for those of the first, {self.calibration.lens}"
                    )
                known = calibration

    def _read_image_size(self) -> Optional[Tuple[int, int]]:
        """(width, height) of the images, None if none of the first can be read."""
        for raw in islice(read_messages(self.path, [self._image_topic]), FIRST_IMAGES):
            with suppress(FrameError):
                height, width = DECODERS[raw.message_type](raw.content()).shape
                return width, height
        return None

    def _read_camera_info(self) -> CameraCalibration:
        """The first calibration in the bag."""
        topic = self._info_topic or ""
        complaint: Optional[InputError] = None
        known: List[Dict[str, Any]] = []
        for _, _, info in self._contents.read("sensor_msgs/msg/CameraInfo", topic):
            fields = camera_info_fields(info)
            if fields in known[-1:]:
                continue
            if len(known) == MOST_CALIBRATIONS:
                break
            known.append(fields)
            try:
                calibration = self._calibration_of(info)
            except InputError as error:  # drivers may begin before they have read their calibration
                complaint = complaint or error
                continue
            doubt = None if self._rectified else distorted_though_rectified(self._image_topic, info.D.tolist())
            if complaint is not None:
                self._warn(f"{complaint}; a later camera_info is used")
            if doubt is not None:
                self._warn(doubt)
            return calibration
        if complaint is not None:
            raise complaint
        others = sorted(name for name, kind in self._types.items() if kind == "sensor_msgs/msg/CameraInfo")
        raise InputError(
            f"{self.path}: no camera_info on {topic} (in the bag: {', '.join(others) or 'none'}); "
            "name its topic or give a camera.txt with the calibration"
        )

    def _calibration_of(self, info: RosMessage) -> CameraCalibration:
        return calibration_from_camera_info(
            **camera_info_fields(info),
            rectified=self._rectified,
            image_size=self._image_size,
            source=f"{self.path}, {self._info_topic}",
        )

    def _moments(self) -> Callable[[RawMessage, RosMessage], Moment]:
        """What tells stamp and exposure time of a message with an image."""
        exposures_ms = self._read_exposures()

        def moment_of(_raw: RawMessage, image: RosMessage) -> Moment:
            stamp_ns = header_stamp_ns(image.header)
            return stamp_ns, exposures_ms.get(stamp_ns)

        return moment_of

    def _read_exposures(self) -> Dict[int, float]:
        """Milliseconds by the stamp of the image."""
        asked = self._topics.exposure or self._topics.beside_image("exposure")
        # Beside the images, or asked for: what Intel's driver publishes.
        of_driver = {t for t in (asked, self._topics.beside_image("metadata")) if self._types.get(t) == METADATA}
        known: Dict[int, Optional[float]] = {}
        for _, _, content in self._contents.read(METADATA, *of_driver):
            known[header_stamp_ns(content.header)] = exposure_in_metadata(content.json_data)
        for _, _, content in self._contents.read("ceiling_dso_ros/msg/Exposure", *({asked} - of_driver)):
            known[header_stamp_ns(content.header)] = content.exposure_ms
        return {stamp_ns: ms for stamp_ns, ms in known.items() if ms is not None and 0.0 < ms < np.inf}

    def _find_mount(self) -> np.ndarray:
        """T_base_camera (4, 4) from tf.

        Raises:
            InputError: the frames are not connected.
        """
        base, camera = self._topics.base_frame, self._topics.camera_frame or self._frame_of_images()
        mount, frames = self._contents.find_transform(base, camera)
        if mount is None:
            raise InputError(
                f"{self.path}: tf has no {base} -> {camera}, its frames are {', '.join(frames) or 'none'}; write "
                f"T_base_camera into {self._robot_file}, or name the frames with --base-frame and --camera-frame"
            )
        return mount

    def _frame_of_images(self) -> str:
        for raw in read_first_and_last(self.path, self._image_topic, TIMED_IMAGES):
            with suppress(FrameError):
                frame = str(raw.content().header.frame_id)
                if frame.strip("/"):
                    return frame
        raise InputError(
            f"{self.path}: the images on {self._image_topic} do not name their frame, so tf has no pose of the camera; "
            f"name it with --camera-frame, or write T_base_camera into {self._robot_file}"
        )
