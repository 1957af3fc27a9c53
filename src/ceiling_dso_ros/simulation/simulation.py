# SPDX-License-Identifier: BSD-3-Clause
"""The simulated robot with all its sensors: measurements ordered by time; images are rendered when they are read."""

import heapq
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, Deque, Dict, Iterator, List, NamedTuple, Union

import numpy as np

from ceiling_dso_ros.io.recording import RobotDescription
from ceiling_dso_ros.simulation import structures
from ceiling_dso_ros.simulation.camera import REFERENCE_EXPOSURE_MS, ExposureControl
from ceiling_dso_ros.simulation.ceilings import CEILINGS
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.events import covered_light, flicker_factor, is_dropped, light_level, parse_events
from ceiling_dso_ros.simulation.rendering import SAMPLE_TIMES, Renderer
from ceiling_dso_ros.simulation.robot import NOMINAL, Robot
from ceiling_dso_ros.simulation.scene import Hall, Scene, build_scene
from ceiling_dso_ros.simulation.sensors import Encoders, InertialUnit, read_encoders, scan
from ceiling_dso_ros.simulation.sequences import SEQUENCES, plan

START_NS = 1_700_000_000_000_000_000  # stamp of time 0
WHEEL_HZ, SCAN_HZ, IMU_HZ = 50.0, 10.0, 200.0
FRAME_JITTER_S = 1.5e-4
RENDER_THREADS, FRAMES_AHEAD = 2, 4


@dataclass(frozen=True)
class CameraFrame:
    """The images of all cameras at one moment.

    Attributes:
        stamp_ns: nanoseconds, the middle of the exposure as the camera's clock tells it.
        time_s: the true time of the simulation.
        exposure_ms: exposure time.
        images: child frame of the camera -> (H, W) uint8; the upward camera's comes first.
    """

    stamp_ns: int
    time_s: float
    exposure_ms: float
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
    """Ranges (541,) in metres at `sensors.SCAN_ANGLES`."""

    stamp_ns: int
    ranges_m: np.ndarray


class ImuReading(NamedTuple):
    """Angular rate (rad/s) and specific force (m/s^2), (3,) each."""

    stamp_ns: int
    angular_rate: np.ndarray
    specific_force: np.ndarray


Measurement = Union[CameraFrame, WheelReading, ScanReading, ImuReading]


@lru_cache(maxsize=2)
def _hall(ceiling: str, seed: int) -> Hall:
    return CEILINGS[ceiling](np.random.default_rng([seed, 0]))


@lru_cache(maxsize=2)
def _scene(ceiling: str, seed: int, focal_px: float, with_floor: bool) -> Scene:
    hall = _hall(ceiling, seed)
    if with_floor:
        hall = replace(hall, surfaces=[*hall.surfaces, structures.floor(*hall.size_m)])
    return build_scene(hall, focal_px, seed)


class Simulation:
    """One drive under one ceiling.

    Images are rendered only when they are read. `encoders` and `robot` take milliseconds, fast enough for Monte Carlo
    runs.

    Attributes:
        config: the settings.
        events: the events with their times.
        robot: the true robot and its motion.
    """

    def __init__(self, config: SimulationConfig) -> None:
        """Plan the drive.

        Raises:
            ConfigError: a setting is out of range.
            EventError: an event is none.
        """
        config.check()
        self.config = config
        motion = plan(SEQUENCES[config.sequence], config.duration_s, self._rng("start"))
        self.duration_s = config.duration_s or motion.duration_s
        self.events = parse_events(config.events, self.duration_s)
        tones = Robot.random_tones(self._rng("vibration"))
        self.robot = Robot(motion, config.wheels.applied(NOMINAL), config.vibration, self.events, tones)
        self._exposure = ExposureControl(config.camera, self.events, self.duration_s, self._rng("exposure"))

    def _rng(self, *stream: Union[str, int]) -> np.random.Generator:
        """A random generator for each purpose, so that the numbers do not depend on what else is simulated."""
        words = [list(word.encode()) if isinstance(word, str) else [word] for word in stream]
        return np.random.default_rng([self.config.seed, *(number for word in words for number in word)])

    @cached_property
    def frame_times_s(self) -> np.ndarray:
        """(N,) middles of the exposures of all images that are not dropped."""
        rng = self._rng("frames")
        count = int((self.duration_s - 0.02) * self.config.camera.fps)
        times = (np.arange(count) + 1) / self.config.camera.fps
        times += np.clip(FRAME_JITTER_S * rng.standard_normal(count), -1e-3, 1e-3)
        kept = [not is_dropped(self.events, time_s, rng) for time_s in times]
        return times[np.array(kept, dtype=bool)]

    @cached_property
    def encoders(self) -> Encoders:
        """All readings of the wheels."""
        times = np.arange(1, int(self.duration_s * WHEEL_HZ)) / WHEEL_HZ + 0.003
        return read_encoders(
            self.robot.motion, self.robot.true, self.config.wheels, self.events, times, self._rng("wheels")
        )

    @property
    def nominal(self) -> RobotDescription:
        """The robot with its nominal dimensions."""
        return NOMINAL

    @property
    def hall(self) -> Hall:
        """The building."""
        return _hall(self.config.ceiling, self.config.seed)

    @property
    def scene(self) -> Scene:
        """The building ready for rendering; takes seconds the first time."""
        return _scene(self.config.ceiling, self.config.seed, self.config.camera.lens.fx, self.config.forward)

    @cached_property
    def cameras(self) -> Dict[str, np.ndarray]:
        """Child frame of each camera -> T_base_camera; the upward one comes first."""
        wanted = {"camera_up_optical_frame": True, "camera_up_right_optical_frame": self.config.stereo}
        wanted["camera_front_optical_frame"] = self.config.forward
        mounts = self.robot.static_transforms()
        return {name: mounts[name] for name, is_wanted in wanted.items() if is_wanted}

    def image_stamp_ns(self, time_s: float) -> int:
        """Stamp of an image on the camera's clock."""
        return stamp_ns(time_s + self.config.time_offset_s)

    @cached_property
    def _renderer(self) -> Renderer:
        return Renderer(self.scene, self.config.camera.pinhole)

    def frames(self) -> Iterator[CameraFrame]:
        """All images, rendered by two threads a few frames ahead."""
        _ = self._renderer  # built once, before the threads need it
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
        camera, time_s = self.config.camera, float(self.frame_times_s[index])
        exposure_ms = self._exposure.exposure_ms(time_s)
        gain = flicker_factor(self.events, time_s, exposure_ms * 1e-3) * light_level(self.events, np.array([time_s]))[0]
        images = {}
        for number, (name, T_base_camera) in enumerate(self.cameras.items()):
            light = self.light(time_s, exposure_ms, T_base_camera) * np.float32(gain)
            if number == 0:
                light = covered_light(self.events, time_s, light)
            images[name] = camera.develop(light, self._rng("noise", number, index))
        return CameraFrame(self.image_stamp_ns(time_s), time_s, exposure_ms, images)

    def light(self, time_s: float, exposure_ms: float, T_base_camera: np.ndarray) -> np.ndarray:
        """Light that a camera receives while all lamps are on, (H, W) float32, where 1 saturates.

        Args:
            time_s: the middle of the exposure.
            exposure_ms: exposure time.
            T_base_camera: (4, 4) mount of the camera.
        """
        T_world_base = self.robot.T_world_base(time_s + SAMPLE_TIMES * exposure_ms * 1e-3)
        radiance = self.config.camera.distort(self._renderer.expose(T_world_base @ T_base_camera))
        return radiance * np.float32(exposure_ms / REFERENCE_EXPOSURE_MS)

    def inverse_depth(self, time_s: float) -> np.ndarray:
        """True 1/z of the upward camera at time_s, (H, W) float32 in 1/m of its pinhole image."""
        return self._renderer.inverse_depth(self.robot.T_world_camera(np.array([time_s]))[0])

    def wheel_readings(self) -> Iterator[WheelReading]:
        """All readings of the encoders."""
        encoders = self.encoders
        angles, poses = encoders.angles_rad(NOMINAL.ticks_per_turn), self.robot.T_world_base(encoders.time_s)
        for time_s, counters, angle, T in zip(encoders.time_s, encoders.counters, angles, poses):
            yield WheelReading(stamp_ns(time_s), counters, angle, T)

    def scans(self) -> Iterator[ScanReading]:
        """All sweeps of the laser scanner."""
        rng = self._rng("scan")
        for time_s in np.arange(0.05, self.duration_s, 1.0 / SCAN_HZ):
            yield ScanReading(stamp_ns(time_s), scan(self.robot, self.hall.floor_plan, time_s, rng))

    def imu_readings(self) -> Iterator[ImuReading]:
        """All readings of the inertial unit, none if there is none."""
        if self.config.imu:
            unit = self._inertial_unit()
            for time_s in np.arange(0.01, self.duration_s, 1.0 / IMU_HZ):
                yield ImuReading(stamp_ns(time_s), *unit.measure(time_s))

    def _inertial_unit(self) -> InertialUnit:
        return InertialUnit(self.robot, self._rng("imu"))

    def measurements(self) -> Iterator[Measurement]:
        """All measurements, ordered by stamp."""
        streams: List[Iterator[Measurement]] = [self.wheel_readings(), self.scans(), self.imu_readings(), self.frames()]
        return iter(heapq.merge(*streams, key=lambda measurement: measurement.stamp_ns))

    def truth(self) -> Dict[str, Any]:
        """All true values and all random choices, for a yaml file."""
        true, start = self.robot.true, self.robot.motion.poses(np.zeros(1))[0]
        unit, lens = self._inertial_unit(), self.config.camera.lens
        return {
            "config": asdict(self.config),
            "duration_s": self.duration_s,
            "path_m": float(np.abs(np.diff(self.robot.motion.travel_m(self.encoders.time_s))).sum()),
            "start_xy_yaw": start.tolist(),
            "events": [asdict(event) for event in self.events],
            "wheel_radius": list(true.wheel_radius_m),
            "wheel_base": true.wheel_base_m,
            "ticks_per_turn": true.ticks_per_turn,
            "first_ticks": self.encoders.ticks[0].tolist(),
            "T_base_camera": true.T_base_camera.tolist(),
            "camera_time_offset_s": self.config.time_offset_s,
            "camera_fx_fy_cx_cy": [lens.fx, lens.fy, lens.cx, lens.cy],
            "exposure_drift_phases": self._exposure.phases.tolist(),
            "vibration_hz_and_phase": self.robot.tones.tolist(),
            "imu_gyro_bias": unit.gyro_bias.tolist(),
            "imu_acceleration_bias": unit.acceleration_bias.tolist(),
            "lamps": [lamp.position.tolist() for lamp in self.hall.lamps],
        }


def stamp_ns(time_s: float) -> int:
    """Time of the simulation as a stamp in integer nanoseconds."""
    return START_NS + round(time_s * 1e9)


def simulate(
    sequence: str = "loops",
    ceiling: str = "factory",
    seed: int = 0,
    **settings: Any,  # noqa: ANN401 each attribute has its own type
) -> Iterator[Measurement]:
    """Measurements of a simulated drive, ordered by time; nothing is written to disk.

    Args:
        sequence: a name of `sequences.SEQUENCES`.
        ceiling: a name of `ceilings.CEILINGS`.
        seed: of all random choices.
        **settings: further attributes of SimulationConfig.

    Raises:
        ConfigError: a setting is out of range.
        EventError: an event is none.
    """
    return Simulation(SimulationConfig(sequence, ceiling, seed, **settings)).measurements()
