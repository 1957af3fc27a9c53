# SPDX-License-Identifier: BSD-3-Clause
"""What is measured: one type for each kind of sensor, with its stamp."""

from dataclasses import dataclass
from typing import Dict, NamedTuple, Optional, Union

import numpy as np

START_NS = 1_700_000_000_000_000_000  # stamp of time 0


def stamp_ns(time_s: float) -> int:
    """Time of the simulation as a stamp in integer nanoseconds."""
    return START_NS + round(time_s * 1e9)


@dataclass(frozen=True)
class CameraFrame:
    """The images of all cameras at one moment.

    Attributes:
        stamp_ns: nanoseconds, the middle of the exposure as the camera's clock tells it.
        time_s: the true time of the simulation.
        exposure_ms: exposure time; None if the camera does not tell it.
        images: child frame of the camera -> (H, W) uint8; the upward camera's comes first.
    """

    stamp_ns: int
    time_s: float
    exposure_ms: Optional[float]
    images: Dict[str, np.ndarray]

    @property
    def image(self) -> np.ndarray:
        """The upward camera's, (H, W) uint8."""
        return next(iter(self.images.values()))


class WheelReading(NamedTuple):
    """Counters of the wheels (left, right) in 32 bits, angles since the start in rad, and the true T_world_base."""

    stamp_ns: int
    counters: np.ndarray
    angles_rad: np.ndarray
    T_world_base: np.ndarray


class ScanReading(NamedTuple):
    """One sweep of the laser scanner: ranges (rays,) in metres at the angles of its model; stamped by the first ray."""

    stamp_ns: int
    ranges_m: np.ndarray


class ImuReading(NamedTuple):
    """Angular rate (rad/s) and specific force (m/s^2), (3,) each."""

    stamp_ns: int
    angular_rate: np.ndarray
    specific_force: np.ndarray


Measurement = Union[CameraFrame, WheelReading, ScanReading, ImuReading]
