# SPDX-License-Identifier: BSD-3-Clause
"""What is asked of a camera, and what it offers."""

import math
from dataclasses import dataclass, field
from typing import Iterable, NamedTuple

from ceiling_dso_ros.io.errors import InputError

EXPOSURE_MS, GAIN = (0.02, 165.0), (16, 248)  # a D455's


class Mode(NamedTuple):
    """Size of the images in pixels, and images a second."""

    width: int
    height: int
    rate_hz: int

    def __str__(self) -> str:
        return f"{self.width}x{self.height} at {self.rate_hz} Hz"


def nearest_mode(offered: Iterable[Mode], wanted: Mode) -> Mode:
    """The mode that is offered and most like the wanted one: its rate counts first, then the number of pixels.

    Args:
        offered: at least one.
        wanted: a mode.
    """

    def distance(mode: Mode) -> tuple:
        pixels = mode.width * mode.height / (wanted.width * wanted.height)
        return abs(mode.rate_hz - wanted.rate_hz), abs(math.log(pixels)), mode

    return min(offered, key=distance)


@dataclass(frozen=True)
class ExposureSettings:
    """How the camera exposes; it may be changed while the camera streams.

    Attributes:
        fixed_ms: exposure time in milliseconds; 0 for automatic exposure.
        fixed_gain: gain with a fixed exposure time, 16 to 248.
        limit_ms: longest time that automatic exposure chooses, milliseconds; 0 for the whole time between images. At
            1.4 m/s under a ceiling 4.5 m above, 8 ms are one pixel of blur.
        gain_limit: largest gain that automatic exposure chooses, 16 to 248; 0 for the camera's own limit.
        metering: automatic exposure looks at a square in the middle of the image, with this share of its height, so
            that lamps at the border do not decide; 0 for the whole image.
    """

    fixed_ms: float = 0.0
    fixed_gain: int = 16
    limit_ms: float = 8.0
    gain_limit: int = 0
    metering: float = 0.6

    def check(self) -> None:
        """Raise InputError when a value is out of range."""
        for name in ("fixed_ms", "limit_ms"):
            value = getattr(self, name)
            _require(value == 0.0 or EXPOSURE_MS[0] <= value <= EXPOSURE_MS[1],
                     f"exposure of {value:g} ms: {EXPOSURE_MS[0]:g} to {EXPOSURE_MS[1]:g}, or 0")  # fmt: skip
        _require(GAIN[0] <= self.fixed_gain <= GAIN[1], f"gain {self.fixed_gain}: {GAIN[0]} to {GAIN[1]}")
        limit = self.gain_limit
        _require(limit == 0 or GAIN[0] <= limit <= GAIN[1], f"limit {limit} of the gain: {GAIN[0]} to {GAIN[1]}, or 0")
        _require(self.metering == 0.0 or 0.05 <= self.metering <= 1.0, f"metering {self.metering:g}: 0.05 to 1, or 0")


@dataclass(frozen=True)
class CameraSettings:
    """Which camera streams what.

    Attributes:
        serial_no: of the camera; empty for the only one that is connected.
        mode: of the images; the nearest one that the camera offers is used.
        stereo: the right images too.
        imu: angular rates and accelerations too.
        exposure: how it exposes.
        recording: file of realsense-viewer or rs.recorder that is played instead of a camera; empty for a camera.
    """

    serial_no: str = ""
    mode: Mode = Mode(848, 480, 30)
    stereo: bool = False
    imu: bool = False
    exposure: ExposureSettings = field(default_factory=ExposureSettings)
    recording: str = ""

    def check(self) -> None:
        """Raise InputError when a value is out of range."""
        width, height, rate_hz = self.mode
        _require(100 <= width <= 1280 and 100 <= height <= 800, f"images of {width}x{height}: 100x100 to 1280x800")
        _require(6 <= rate_hz <= 90, f"{rate_hz} images a second: 6 to 90")
        self.exposure.check()


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise InputError(message)
