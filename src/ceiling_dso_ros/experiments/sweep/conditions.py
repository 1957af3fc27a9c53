# SPDX-License-Identifier: BSD-3-Clause
"""What is used of a recording, and how its images are made worse."""

from dataclasses import dataclass
from typing import Optional, Tuple

from ceiling_dso_ros.dso.config import ConfigError, require
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.image_scaling import parse_image_size
from ceiling_dso_ros.io.recording_view import LONGEST_S


@dataclass(frozen=True)
class Conditions:
    """The dimensions of a study that are no settings of the odometry or the fusion.

    Attributes:
        size: WxH that the images are scaled to; empty for their own.
        fps: images a second; 0 for all.
        start: begin of the part that is used, seconds after the first image.
        duration: its length, seconds; 0 for all that follows.
        no_exposure: the exposure times are not used.
        no_prediction: the wheels do not predict the motion of the camera.
        drop: share of the images that are lost on the way.
        noise: standard deviation of noise that is added, grey levels of 255.
        blur: standard deviation of a Gaussian that blurs the images, pixels.
        exposure: the brightness goes up and down by this share, as with automatic exposure; exposure times tell it.
        stamp_jitter: standard deviation of noise on the stamps, seconds.
    """

    size: str = ""
    fps: float = 0.0
    start: float = 0.0
    duration: float = 0.0
    no_exposure: bool = False
    no_prediction: bool = False
    drop: float = 0.0
    noise: float = 0.0
    blur: float = 0.0
    exposure: float = 0.0
    stamp_jitter: float = 0.0

    def check(self) -> None:
        """Raise ConfigError when a value is out of range."""
        for name, most in (
            ("fps", 1000.0), ("start", LONGEST_S), ("duration", LONGEST_S), ("drop", 0.99), ("noise", 100.0),
            ("blur", 50.0), ("exposure", 10.0), ("stamp_jitter", 1.0),
        ):  # fmt: skip
            value = getattr(self, name)
            require(0.0 <= value <= most, f"{name}={value:g}: 0 to {most:g}")
        try:
            self.image_size()
        except InputError as error:
            raise ConfigError(str(error)) from error

    def image_size(self) -> Optional[Tuple[int, int]]:
        """(width, height) that the images are scaled to, None for their own."""
        return parse_image_size(self.size, "size") if self.size else None
