# SPDX-License-Identifier: BSD-3-Clause
"""A second camera beside the first, called right, whose images are taken at the same time as those of the first."""

import math
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Callable, Iterator, Mapping, NamedTuple, Optional, Sequence

import numpy as np

from ceiling_dso_ros.io.bag_contents import BagContents
from ceiling_dso_ros.io.bag_reader import RawMessage, read_first_and_last, read_messages
from ceiling_dso_ros.io.camera_info import calibration_from_camera_info, camera_info_fields
from ceiling_dso_ros.io.camera_models import read_camera_file
from ceiling_dso_ros.io.errors import FrameError, InputError
from ceiling_dso_ros.io.known_names import require_known
from ceiling_dso_ros.io.photometric import PhotometricCalibration
from ceiling_dso_ros.io.recording import SecondCamera, TopicNames
from ceiling_dso_ros.io.robot_file import rigid_motion
from ceiling_dso_ros.io.ros_messages import RosMessage, header_stamp_ns
from ceiling_dso_ros.io.yaml_files import read_yaml

PAIRED_NS = 10**6  # of the stamps of two images of one moment: less than an exposure
LAG_NS = 10**9  # by which one camera's images may be recorded later than the other's
SHORTEST_BASELINE_M = 1e-3
TRIED = 10  # messages that are tried for the frame

Decode = Callable[[RosMessage], np.ndarray]


class _RightImage(NamedTuple):
    stamp_ns: int
    recorded_ns: int
    decode: Callable[[], np.ndarray]


class PairedImages:
    """Reads the right images of a bag along with the left ones; holds one of them."""

    def __init__(self, path: Path, topic: str, decode: Decode) -> None:
        self._messages = _right_images(path, topic, decode)
        self._next = next(self._messages, None)

    def at(self, stamp_ns: int, recorded_ns: int) -> Optional[Callable[[], np.ndarray]]:
        """Gives the right image of a left one; None if there is none.

        Args:
            stamp_ns: of the header of the left image.
            recorded_ns: when that was recorded; not before those asked for earlier.

        Raises:
            InputError: the bag cannot be read on.
        """
        while self._next is not None and (
            self._next.stamp_ns < stamp_ns - PAIRED_NS or self._next.recorded_ns < recorded_ns - LAG_NS
        ):
            self._next = next(self._messages, None)
        if self._next is None or abs(self._next.stamp_ns - stamp_ns) > PAIRED_NS:
            return None
        return self._next.decode


def pose_of_right(T_by_tf: Optional[np.ndarray], P: Sequence[float], source: str) -> np.ndarray:
    """T_left_right by tf, else by P: cameras of a pair that is rectified differ by a translation, -P[3] / P[0].

    Args:
        T_by_tf: (4, 4); None if tf does not have it.
        P: (12,) of the camera_info of the second camera.
        source: of that, for the message.

    Raises:
        InputError: neither says it.
    """
    if T_by_tf is not None and np.linalg.norm(T_by_tf[:3, 3]) > SHORTEST_BASELINE_M:
        return T_by_tf
    T = np.eye(4)
    if len(P) == 12 and P[0] > 0.0 and P[5] > 0.0:
        T[:2, 3] = -P[3] / P[0], -P[7] / P[5]
    if not SHORTEST_BASELINE_M < math.hypot(T[0, 3], T[1, 3]) < math.inf:
        raise InputError(f"{source}: neither tf nor P says where the second camera is")
    return T


def _right_images(path: Path, topic: str, decode: Decode) -> Iterator[_RightImage]:
    for raw in read_messages(path, [topic]):
        with suppress(FrameError):
            image = raw.content()
            yield _RightImage(header_stamp_ns(image.header), raw.stamp_ns, partial(decode, image))


class SecondCameraInBag:
    """Finds the second camera in a bag.

    Args:
        contents: of the bag.
        topics: with `right_image`.
        decoders: by the type of the messages.
        left_topic: of the images of the first camera.
        rectified: P of camera_info describes the images, not K and D.
        warn: is told why right images cannot be used.
    """

    def __init__(
        self, contents: BagContents, topics: TopicNames, decoders: Mapping[str, Decode], left_topic: str,
        rectified: bool, warn: Callable[[str], None],
    ) -> None:  # fmt: skip
        self._contents = contents
        self._decoders = decoders
        self._left_topic = left_topic
        self._rectified = rectified
        self._warn = warn
        names = (topics.right_image, f"{topics.right_image}/compressed")
        self._topic = next((name for name in names if contents.types.get(name) in decoders), "")
        self._asked = topics.right_image
        own = replace(topics, image=topics.right_image)
        self._info_topic = topics.right_camera_info or own.beside_image("camera_info")

    def images(self) -> Optional[PairedImages]:
        """The images, from the first on; None without a second camera."""
        if not self._topic:
            return None
        return PairedImages(self._contents.path, self._topic, self._decoders[self._contents.types[self._topic]])

    def camera(self) -> Optional[SecondCamera]:
        """The calibration; None without a second camera, or where what is needed is not in the bag, which is told."""
        if not self._topic:
            if self._asked not in ("", TopicNames.right_image):
                self._warn(f"{self._contents.path}: there are no images on {self._asked}")
            return None
        try:
            info = self._first_info()
            fields, source = camera_info_fields(info), f"{self._contents.path}, {self._info_topic}"
            calibration = calibration_from_camera_info(**fields, rectified=self._rectified, source=source)
            return SecondCamera(calibration, PhotometricCalibration.linear(), self._pose(fields["P"]))
        except (FrameError, InputError) as error:
            self._warn(f"{error}; the images on {self._topic} are not used")
            return None

    def _first_info(self) -> RosMessage:
        for _, _, info in self._contents.read("sensor_msgs/msg/CameraInfo", self._info_topic):
            return info
        raise InputError(f"{self._contents.path}: no camera_info on {self._info_topic}")

    def _pose(self, P: Sequence[float]) -> np.ndarray:
        left, right = (self._frame_of(topic) for topic in (self._left_topic, self._topic))
        T = self._contents.find_transform(left, right)[0] if left and right and left != right else None
        return pose_of_right(T, P, f"{self._contents.path}, {self._info_topic}")

    def _frame_of(self, topic: str) -> str:
        for raw in _first(self._contents.path, topic):
            with suppress(FrameError):
                frame = str(raw.content().header.frame_id).lstrip("/")
                if frame:
                    return frame
        return ""


def _first(path: Path, topic: str) -> Iterator[RawMessage]:
    yield from read_first_and_last(path, topic, TRIED)


def read_second_camera(camera_file: Path, rig_file: Path) -> SecondCamera:
    """The second camera of a folder.

    Args:
        camera_file: its `camera_right.txt`.
        rig_file: yaml with T_left_right {xyz, quat_xyzw}, metres.

    Raises:
        InputError: a file cannot be used.
    """
    content = read_yaml(rig_file)
    values = content if isinstance(content, dict) else {}
    require_known(values, {"T_left_right": {"xyz": None, "quat_xyzw": None}}, str(rig_file))
    T = rigid_motion(values.get("T_left_right"), "T_left_right", str(rig_file))
    if np.linalg.norm(T[:3, 3]) < SHORTEST_BASELINE_M:
        raise InputError(f"{rig_file}: T_left_right: the second camera is where the first one is")
    return SecondCamera(read_camera_file(camera_file), PhotometricCalibration.linear(), T)
