# SPDX-License-Identifier: BSD-3-Clause
"""The interface of recordings, for folders and bags."""

import enum
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable, Iterator, Optional, Tuple, Union

import numpy as np

from ceiling_dso_ros.io.camera_models import CameraCalibration
from ceiling_dso_ros.io.errors import FrameError
from ceiling_dso_ros.io.frame_order import judged
from ceiling_dso_ros.io.frame_rate import FrameRateLimit
from ceiling_dso_ros.io.photometric import PhotometricCalibration


@dataclass(frozen=True)
class Frame:
    """One image as it was recorded.

    Attributes:
        stamp_ns: nanoseconds.
        exposure_ms: exposure time, None when unknown.
        image: (H, W) uint8, uint16 or float32, raw.
        right: gives the raw image of the second camera of the same moment, or raises FrameError; None without one.
    """

    stamp_ns: int
    exposure_ms: Optional[float]
    image: np.ndarray
    right: Optional[Callable[[], np.ndarray]] = None


@dataclass(frozen=True)
class SkippedFrame:
    """Placeholder for an image that cannot be used.

    Attributes:
        stamp_ns: nanoseconds, None when unknown.
        reason: one line that names the image and says what is wrong.
        kind: what is wrong, without the image's name.
    """

    stamp_ns: Optional[int]
    reason: str
    kind: str


@dataclass(frozen=True)
class ListedImage:
    """An image that a recording lists, not read yet.

    Attributes:
        stamp_ns: nanoseconds, None when unknown.
        exposure_ms: exposure time, None when unknown.
        name: names the image in messages.
        decode: gives the raw image (H, W) uint8, uint16 or float32, or raises FrameError.
        recorded_ns: when it was recorded, nanoseconds by the recorder's clock; None where that is unknown.
        right: see Frame.
    """

    stamp_ns: Optional[int]
    exposure_ms: Optional[float]
    name: str
    decode: Callable[[], np.ndarray]
    recorded_ns: Optional[int] = None
    right: Optional[Callable[[], np.ndarray]] = None


class WheelUnit(enum.Enum):
    """What a recording says of the wheels."""

    TICKS = "ticks"  # counters, which may wrap around
    RADIANS = "radians"  # angles, endless or wrapped at a whole turn
    POSES = "poses"  # of the base, by the robot's own wheel odometry


@dataclass(frozen=True)
class WheelSamples:
    """Readings of the two wheels as recorded.

    Attributes:
        unit: of the readings.
        stamps_ns: (N,) int64 nanoseconds, increasing.
        readings: (N, 2) of the left and the right wheel, int64 ticks or float64 radians; or (N, 3) float64 poses x, y,
            yaw.
        source: names them in messages.
        delay_ns: how long after their stamps they were recorded, in the median; None where that is unknown.
        set_back: their clock was set back while they were recorded.
        arrivals_ns: (M, 2) int64 stamps of all messages and when they were recorded, in the order of recording; None
            where that is unknown.
    """

    unit: WheelUnit
    stamps_ns: np.ndarray
    readings: np.ndarray
    source: str = "the wheels"
    delay_ns: Optional[int] = None
    set_back: bool = False
    arrivals_ns: Optional[np.ndarray] = None

    def __len__(self) -> int:
        """How many there are."""
        return len(self.stamps_ns)

    def __iter__(self) -> Iterator[Tuple[Any, ...]]:
        """The arguments of `add_ticks`, `add_angles` or `add_pose` for each, in the order of time."""
        stamps_ns = self.stamps_ns.tolist()
        if self.unit is WheelUnit.POSES:
            return zip(stamps_ns, self.readings)
        return zip(stamps_ns, *self.readings.T.tolist())


@dataclass(frozen=True)
class RobotDescription:
    """A differential drive with its camera, nominal values.

    Attributes:
        ticks_per_turn: encoder ticks per turn of a wheel.
        wheel_radius_m: left, right.
        wheel_base_m: distance between the wheels.
        T_base_camera: (4, 4) pose of the camera's optical frame in base_link.
        camera_time_offset_s: what to add to an image's stamp to have it on the wheels' clock.
    """

    ticks_per_turn: float
    wheel_radius_m: Tuple[float, float]
    wheel_base_m: float
    T_base_camera: np.ndarray
    camera_time_offset_s: float = 0.0


@dataclass(frozen=True)
class SecondCamera:
    """A camera beside the first, called right, whose images are taken at the same time.

    Attributes:
        calibration: of its raw images.
        photometric: of its raw images.
        T_left_right: (4, 4) pose of its optical frame in that of the first camera, metres.
    """

    calibration: CameraCalibration
    photometric: PhotometricCalibration
    T_left_right: np.ndarray


@dataclass(frozen=True)
class ImageTimes:
    """When the images of a recording were taken.

    Attributes:
        first_ns, last_ns: stamps, nanoseconds.
        delay_ns: how long after their stamps images were recorded, in the median; None where that is unknown.
    """

    first_ns: int
    last_ns: int
    delay_ns: Optional[int] = None


@dataclass(frozen=True)
class TopicNames:
    """Topics of a bag; the defaults are those of the simulator.

    Attributes:
        image: sensor_msgs/Image or sensor_msgs/CompressedImage (`/compressed` may be left out).
        camera_info: sensor_msgs/CameraInfo; None for camera_info in the namespace of the image topic.
        exposure: ceiling_dso_ros/Exposure, optional in the bag; None for exposure in the namespace of the image topic.
        left_ticks, right_ticks: std_msgs/Int32 counters of the wheels, optional in the bag.
        joint_states: sensor_msgs/JointState with the wheels' angles, optional in the bag.
        left_joint, right_joint: names of the wheels in it; empty for those that `WheelJoints` finds.
        wheel_odometry: nav_msgs/Odometry, the robot's own, optional in the bag.
        wheel_input: which of them is used: ticks, joint_states or odometry; empty for ticks, else joint states.
        base_frame: the robot's frame, on the floor between the wheels.
        camera_frame: the camera's optical frame; empty for that of the images.
        right_image: images of a second camera at the stamps of the first one's, optional in the bag; empty to leave
            them out.
        right_camera_info: of it; None for camera_info in the namespace of its images.
    """

    image: str = "/camera/up/image_raw"
    camera_info: Optional[str] = None
    exposure: Optional[str] = None
    left_ticks: str = "/wheel/left/ticks"
    right_ticks: str = "/wheel/right/ticks"
    joint_states: str = "/joint_states"
    left_joint: str = ""
    right_joint: str = ""
    wheel_odometry: str = "/odom"
    wheel_input: str = ""
    base_frame: str = "base_link"
    camera_frame: str = ""
    right_image: str = "/camera/up_right/image_raw"
    right_camera_info: Optional[str] = None

    def beside_image(self, name: str) -> str:
        """The topic of that name in the namespace of the image topic."""
        image = self.image[: -len("/compressed")] if self.image.endswith("/compressed") else self.image
        return f"{image.rpartition('/')[0]}/{name}"


class Recording(ABC):
    """A camera's images with their calibration, and optional wheel and reference data.

    Attributes:
        path: the folder or the bag.
        calibration: of the camera.
        photometric: of the camera.
        uses_exposures: the frames have the exposure times of the recording; otherwise none.
    """

    path: Path
    calibration: CameraCalibration
    photometric: PhotometricCalibration
    uses_exposures: bool = True

    @property
    def name(self) -> str:
        """Name of the folder, or of the bag without its ending."""
        return self.path.resolve().name if self.path.is_dir() else self.path.stem

    @abstractmethod
    def __len__(self) -> int:
        """Number of images listed, including unusable ones."""

    @abstractmethod
    def images(self) -> Iterator[ListedImage]:
        """All images listed, in the order of the recording.

        Raises:
            InputError: the recording turns out to be damaged.
        """

    def image_times(self) -> Optional[ImageTimes]:
        """When the images were taken; None where no image has a stamp.

        Raises:
            InputError: the recording turns out to be damaged.
        """
        stamps_ns = [listed.stamp_ns for listed in self.images() if listed.stamp_ns is not None]
        return ImageTimes(min(stamps_ns), max(stamps_ns)) if stamps_ns else None

    @property
    def second_camera(self) -> Optional[SecondCamera]:
        """The camera beside the first, None where there is none.

        Raises:
            InputError: it cannot be read.
        """
        return None

    @property
    @abstractmethod
    def wheels(self) -> Optional[WheelSamples]:
        """Wheel encoders, None where there are none.

        Raises:
            InputError: they cannot be read.
        """

    @property
    @abstractmethod
    def robot(self) -> Optional[RobotDescription]:
        """Dimensions of the robot, None where they are unknown.

        Raises:
            InputError: they cannot be read.
        """

    @property
    @abstractmethod
    def ground_truth_path(self) -> Optional[Path]:
        """TUM file with the true poses of the camera's optical frame, None where there is none."""

    def frames(
        self,
        frame_rate: float = 0.0,
        wheels: Optional[WheelSamples] = None,
        leaves_out: Callable[[int], bool] = lambda _: False,
    ) -> Iterator[Union[Frame, SkippedFrame]]:
        """The images in the order of the recording, each one read when it is asked for.

        A bad image (unreadable, of another size, or whose stamp is wrong, see `judged`) comes as a SkippedFrame.

        Args:
            frame_rate: images a second, see `FrameRateLimit`; 0 for all.
            wheels: what the images are used with.
            leaves_out: whether not to read the image with a stamp, nanoseconds; asked when all before have been used.

        Raises:
            InputError: the recording turns out to be damaged.
        """
        limit = FrameRateLimit(frame_rate)
        for listed, fault in judged(self.images(), wheels):
            stamp_ns = listed.stamp_ns
            if stamp_ns is not None and not fault and (not limit.passes(stamp_ns) or leaves_out(stamp_ns)):
                continue
            try:
                if fault:
                    raise FrameError(fault)
                image = self._read(listed)
                if stamp_ns is None:
                    raise FrameError("it has no time stamp")
            except FrameError as error:
                yield SkippedFrame(stamp_ns, f"{listed.name}: {error}; frame skipped", str(error))
                continue
            exposure_ms = listed.exposure_ms if self.uses_exposures else None
            yield Frame(stamp_ns, exposure_ms, image, listed.right)

    def _read(self, listed: ListedImage) -> np.ndarray:
        image = listed.decode()
        self.calibration.require_size_of(image)
        return image
