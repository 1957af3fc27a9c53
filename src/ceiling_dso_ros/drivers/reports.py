# SPDX-License-Identifier: BSD-3-Clause
"""What the process that streams a camera and the one that uses it tell each other."""

from dataclasses import dataclass
from typing import NamedTuple, Optional, Tuple, Union

import numpy as np

from ceiling_dso_ros.drivers.image_times import FrameTimes, HostTime
from ceiling_dso_ros.drivers.settings import ExposureSettings, Mode
from ceiling_dso_ros.io.errors import InputError


class CameraError(InputError):
    """There is no camera that can be used; the message says why, in one line."""


@dataclass(frozen=True)
class Lens:
    """Intrinsics of rectified images, pixels.

    Attributes:
        K: (3, 3) camera matrix.
        distortion: coefficients k1 k2 p1 p2 k3.
    """

    K: np.ndarray
    distortion: Tuple[float, ...]


@dataclass(frozen=True)
class CameraDescription:
    """A camera that streams.

    Attributes:
        name: of the product, such as Intel RealSense D455.
        serial_no: its serial number.
        firmware: its version.
        usb: version of the connection, such as 3.2.
        port: where it is connected.
        mode: of its images.
        left, right: lenses; right is None without stereo.
        T_left_right: (4, 4) pose of the right camera's optical frame in the left one's, metres.
        T_left_imu: (4, 4) pose of the inertial unit in the left camera's optical frame; None without it.
        has_metadata: the images come with exposure times and the device's time; None where nobody knows.
        complaints: lines about what is not as it was asked for.
    """

    name: str
    serial_no: str
    firmware: str
    usb: str
    port: str
    mode: Mode
    left: Lens
    right: Optional[Lens]
    T_left_right: Optional[np.ndarray]
    T_left_imu: Optional[np.ndarray]
    has_metadata: Optional[bool]
    complaints: Tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.name} {self.serial_no}, firmware {self.firmware}, USB {self.usb}, {self.mode}"


# From the streaming process.


class Waiting(NamedTuple):
    """There are no images.

    Attributes:
        message: why, in one line.
        patience_s: the next report comes within this time, or the process hangs.
    """

    message: str
    patience_s: float


class Connected(NamedTuple):
    """Streaming has begun."""

    camera: CameraDescription


class CapturedImages(NamedTuple):
    """Images of one moment.

    Attributes:
        images: (H, W) uint8 of the left camera, and of the right one with stereo.
        times: when they were taken.
        number: the camera counts them.
        arrival: when they were received.
        gain: of the sensor; None if unknown.
    """

    images: Tuple[np.ndarray, ...]
    times: FrameTimes
    number: int
    arrival: HostTime
    gain: Optional[int]


class InertialReading(NamedTuple):
    """Angular rate or acceleration.

    Attributes:
        counter_us: the device's counter.
        is_rate: an angular rate, rad/s, or a specific force, m/s^2.
        vector: (3,) in the frame of the inertial unit.
    """

    counter_us: int
    is_rate: bool
    vector: Tuple[float, float, float]


class InertialReadings(NamedTuple):
    """Several, in the order of their arrival."""

    readings: Tuple[InertialReading, ...]


class Remark(NamedTuple):
    """Something to be logged, one line."""

    message: str


Report = Union[Waiting, Connected, CapturedImages, InertialReadings, Remark]


# To the streaming process.


class Expose(NamedTuple):
    """Expose in another way from now on."""

    exposure: ExposureSettings


class ResetDevice(NamedTuple):
    """Restart the camera, as if it was unplugged."""


Command = Union[Expose, ResetDevice]
