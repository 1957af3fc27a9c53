# SPDX-License-Identifier: BSD-3-Clause
"""A planned drive with all sensors: measurements ordered by time; images are rendered when they are read."""

import heapq
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict
from functools import cached_property
from typing import Any, Deque, Dict, Iterator, List

import numpy as np

from ceiling_dso_ros.simulation.camera import frame_jitter_s
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.driving.carried import carried
from ceiling_dso_ros.simulation.driving.sequences import plan
from ceiling_dso_ros.simulation.events import is_dropped, parse_events
from ceiling_dso_ros.simulation.obstacles import Obstacles
from ceiling_dso_ros.simulation.sensors.encoders import WHEEL_HZ, Encoders, read_encoders
from ceiling_dso_ros.simulation.sensors.inertial import InertialUnit
from ceiling_dso_ros.simulation.sensors.laser import SCAN_HZ, SWEEP_S, LaserScanner
from ceiling_dso_ros.simulation.sensors.measurements import (
    CameraFrame,
    ImuReading,
    Measurement,
    ScanReading,
    WheelReading,
    stamp_ns,
)
from ceiling_dso_ros.simulation.world import World, hall_of, stream_of

IMU_HZ = 200.0
RENDER_THREADS, FRAMES_AHEAD = 2, 4


class Simulation(World):
    """One planned drive under one ceiling.

    Images are rendered only when they are read. `encoders` and `robot` take milliseconds, fast enough for Monte Carlo
    runs.

    Attributes:
        duration_s: length of the drive.
    """

    def __init__(self, config: SimulationConfig) -> None:
        """Plan the drive.

        Raises:
            ConfigError: a setting is out of range.
            EventError: an event is none.
        """
        config.check()
        self._motion = plan(config.sequence, config.duration_s, stream_of(config, "start"))
        self.duration_s = config.duration_s or self._motion.duration_s
        events = parse_events(config.events, self.duration_s)
        places = stream_of(config, "kidnap")
        super().__init__(config, carried(self._motion, events, hall_of(config).size_m, places), events)

    @cached_property
    def frame_times_s(self) -> np.ndarray:
        """(N,) middles of the exposures of all images that are not dropped."""
        rng = self.rng("frames")
        count = int((self.duration_s - 0.02) * self.config.camera.fps)
        times = (np.arange(count) + 1) / self.config.camera.fps
        times += frame_jitter_s(rng, count)
        kept = [not is_dropped(self.events, time_s, rng) for time_s in times]
        return times[np.array(kept, dtype=bool)]

    @cached_property
    def obstacles(self) -> Obstacles:
        """What stands and moves on the floor."""
        return self.obstacles_around(self.robot.motion, self.duration_s)

    @cached_property
    def encoders(self) -> Encoders:
        """All readings of the wheels."""
        times = np.arange(1, int(self.duration_s * WHEEL_HZ)) / WHEEL_HZ + 0.003
        wheels, rng = self.config.wheels, self.rng("wheels")
        return read_encoders(self._motion, self.robot.true, wheels, self.events, times, rng)

    def frames(self) -> Iterator[CameraFrame]:
        """All images, rendered by two threads a few frames ahead."""
        _ = self.renderer  # built once, before the threads need it
        waiting: Deque[Future[CameraFrame]] = deque()
        executor = ThreadPoolExecutor(RENDER_THREADS, thread_name_prefix="render")
        try:
            for index in range(len(self.frame_times_s)):
                waiting.append(executor.submit(self.frame, index))
                if len(waiting) > FRAMES_AHEAD:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()
            executor.shutdown()

    def frame(self, index: int) -> CameraFrame:
        """The image at frame_times_s[index]."""
        return self.images_at(float(self.frame_times_s[index]), index)

    def wheel_readings(self) -> Iterator[WheelReading]:
        """All readings of the encoders."""
        encoders = self.encoders
        angles = encoders.angles_rad(self.nominal.ticks_per_turn)
        poses = self.robot.T_world_base(encoders.time_s)
        for time_s, counters, angle, T in zip(encoders.time_s, encoders.counters, angles, poses):
            yield WheelReading(stamp_ns(time_s), counters, angle, T)

    def scans(self) -> Iterator[ScanReading]:
        """All sweeps of the laser scanner."""
        return self.scans_of(LaserScanner(self.obstacles, self.rng("scan"), self.config.laser))

    def scans_of(self, scanner: LaserScanner) -> Iterator[ScanReading]:
        """All sweeps of a scanner."""
        for time_s in np.arange(0.05, self.duration_s - SWEEP_S, 1.0 / SCAN_HZ):
            yield ScanReading(stamp_ns(time_s), scanner.sweep(self.robot.motion, time_s))

    def imu_readings(self) -> Iterator[ImuReading]:
        """All readings of the inertial unit, none if there is none."""
        if self.config.imu:
            unit = self._inertial_unit()
            for time_s in np.arange(0.01, self.duration_s, 1.0 / IMU_HZ):
                yield ImuReading(stamp_ns(time_s), *unit.measure(time_s))

    def _inertial_unit(self) -> InertialUnit:
        return InertialUnit(self.robot, self.rng("imu"))

    def measurements(self) -> Iterator[Measurement]:
        """All measurements, ordered by stamp."""
        streams: List[Iterator[Measurement]] = [self.wheel_readings(), self.scans(), self.imu_readings(), self.frames()]
        return iter(heapq.merge(*streams, key=lambda measurement: measurement.stamp_ns))

    def truth(self) -> Dict[str, Any]:
        """All true values and all random choices, for a yaml file."""
        true, start = self.robot.true, self._motion.poses(np.zeros(1))[0]
        unit, lens = self._inertial_unit(), self.config.camera.lens
        return {
            "config": asdict(self.config),
            "duration_s": self.duration_s,
            "path_m": float(np.abs(np.diff(self._motion.travel_m(self.encoders.time_s))).sum()),
            "start_xy_yaw": start.tolist(),
            "events": [asdict(event) for event in self.events],
            "wheel_radius": list(true.wheel_radius_m),
            "wheel_base": true.wheel_base_m,
            "ticks_per_turn": true.ticks_per_turn,
            "first_ticks": self.encoders.ticks[0].tolist(),
            "T_base_camera": true.T_base_camera.tolist(),
            "camera_time_offset_s": self.config.time_offset_s,
            "camera_fx_fy_cx_cy": [lens.fx, lens.fy, lens.cx, lens.cy],
            "camera_distortion": list(lens.distortion),
            "exposure_drift_phases": self.exposure.phases.tolist(),
            "vibration_hz_and_phase": self.robot.tones.tolist(),
            "imu_gyro_bias": unit.gyro_bias.tolist(),
            "imu_acceleration_bias": unit.acceleration_bias.tolist(),
            "hall": self.hall.description,
            "lamps": [lamp.position.tolist() for lamp in self.hall.lamps],
        }


def simulate(
    sequence: str = "loops",
    ceiling: str = "factory",
    seed: int = 0,
    **settings: Any,  # noqa: ANN401 each attribute has its own type
) -> Iterator[Measurement]:
    """Measurements of a simulated drive, ordered by time; nothing is written to disk.

    Args:
        sequence: a name of `sequences.SEQUENCES` or `TOURS`.
        ceiling: a name of `ceilings.CEILINGS`.
        seed: of all random choices.
        **settings: further attributes of SimulationConfig.

    Raises:
        ConfigError: a setting is out of range.
        EventError: an event is none.
    """
    return Simulation(SimulationConfig(sequence, ceiling, seed, **settings)).measurements()
