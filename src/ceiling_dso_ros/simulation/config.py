# SPDX-License-Identifier: BSD-3-Clause
"""Settings of a simulated recording."""

from dataclasses import dataclass, field
from typing import Tuple

from ceiling_dso_ros.dso.config import ConfigError, require
from ceiling_dso_ros.simulation.camera import CameraModel
from ceiling_dso_ros.simulation.ceilings import CEILINGS
from ceiling_dso_ros.simulation.driving.sequences import SEQUENCES, TOURS
from ceiling_dso_ros.simulation.robot import Vibration, WheelErrors
from ceiling_dso_ros.simulation.sensors.laser import LaserModel

__all__ = ["ConfigError", "SimulationConfig"]

FREE_FLOOR = "random"  # the ceiling of halls in which nothing stands


@dataclass(frozen=True)
class SimulationConfig:
    """Settings of one simulated drive.

    Attributes:
        sequence: a name of SEQUENCES or TOURS.
        ceiling: a name of CEILINGS.
        seed: of all random choices.
        session: the hall, the camera and the robot stay those of the seed, all else is another time's: where the drive
            starts, the noise, and from session 1 on also which third of the lamps is off.
        duration_s: length; further laps are driven until then, or the sequence is cut. 0 for one lap.
        camera: of all images.
        wheels: differences between the real and the nominal wheels.
        vibration: of the base.
        laser: of the scans.
        traffic: people and vehicles that move through the hall beside those that always do, for planned drives alone:
            they keep away from the robot.
        events: texts as `events.parse_events` takes them.
        time_offset_s: delay of the image stamps: stamp minus true time.
        exposures_told: the camera tells the exposure times.
        stereo: a second upward camera, 95 mm to the right.
        forward: a camera that looks ahead.
        imu: an inertial unit.
    """

    sequence: str = "loops"
    ceiling: str = "factory"
    seed: int = 0
    session: int = 0
    duration_s: float = 0.0
    camera: CameraModel = field(default_factory=CameraModel)
    wheels: WheelErrors = field(default_factory=WheelErrors)
    vibration: Vibration = field(default_factory=Vibration)
    laser: LaserModel = field(default_factory=LaserModel)
    traffic: int = 0
    events: Tuple[str, ...] = ()
    time_offset_s: float = 0.0
    exposures_told: bool = True
    stereo: bool = False
    forward: bool = False
    imu: bool = False

    def check(self) -> None:
        """Raise ConfigError when a value is out of range."""
        known = (*SEQUENCES, *TOURS)
        require(self.sequence in known, f"sequence '{self.sequence}': one of {', '.join(known)}")
        require(self.ceiling in CEILINGS, f"ceiling '{self.ceiling}': one of {', '.join(CEILINGS)}")
        require(0 <= self.seed < 2**32, f"seed {self.seed}: 0 to {2**32 - 1}")
        free = self.sequence not in TOURS or self.ceiling == FREE_FLOOR
        require(
            free, f"sequence '{self.sequence}': leads all over the floor, which only the ceiling '{FREE_FLOOR}' has"
        )
        require(0 <= self.session < 1000, f"session {self.session}: 0 to 999")
        fits = self.duration_s == 0.0 or 0.5 <= self.duration_s <= 7200.0
        require(fits, f"duration {self.duration_s:g} s: 0.5 to 7200 s, or 0 for one lap")
        require(abs(self.time_offset_s) <= 0.2, f"time offset {self.time_offset_s:g} s: -0.2 to 0.2")
        for name, limit in (("radius", 0.2), ("ratio", 0.2), ("wheel_base", 0.2), ("travel_noise_m", 0.05)):
            value = getattr(self.wheels, name)
            require(abs(value) <= limit, f"wheels.{name} {value:g}: -{limit:g} to {limit:g}")
        require(self.wheels.travel_noise_m >= 0.0, "wheels.travel_noise_m: must not be negative")
        require(0.0 <= self.wheels.turn_slip <= 0.2, f"wheels.turn_slip {self.wheels.turn_slip:g}: 0 to 0.2")
        require(0.0 <= self.wheels.tick_noise <= 100.0, f"wheels.tick_noise {self.wheels.tick_noise:g}: 0 to 100 ticks")
        require(0 <= self.traffic <= 100, f"traffic {self.traffic}: 0 to 100")
        self.laser.check()
        self.camera.check()
