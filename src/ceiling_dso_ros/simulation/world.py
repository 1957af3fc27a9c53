# SPDX-License-Identifier: BSD-3-Clause
"""A hall with a robot in it: what planned and commanded drives have in common, the images above all."""

from dataclasses import replace
from functools import cached_property, lru_cache
from typing import Dict, List, Union

import numpy as np

from ceiling_dso_ros.io.recording import RobotDescription
from ceiling_dso_ros.simulation.camera import REFERENCE_EXPOSURE_MS, ExposureControl
from ceiling_dso_ros.simulation.ceilings import CEILINGS
from ceiling_dso_ros.simulation.ceilings.other_lights import with_lamps_off
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.driving.motion import BaseMotion
from ceiling_dso_ros.simulation.events import Event, covered_light, flicker_factor, light_level
from ceiling_dso_ros.simulation.obstacles import Obstacles, draw_traffic
from ceiling_dso_ros.simulation.rendering import structures
from ceiling_dso_ros.simulation.rendering.renderer import SAMPLE_TIMES, Renderer
from ceiling_dso_ros.simulation.rendering.scene import Hall, Scene, build_scene
from ceiling_dso_ros.simulation.robot import NOMINAL, Robot
from ceiling_dso_ros.simulation.sensors.measurements import CameraFrame, stamp_ns

TRAFFIC_STEP_S = 0.1


@lru_cache(maxsize=2)
def _hall(ceiling: str, seed: int, session: int) -> Hall:
    hall = CEILINGS[ceiling](np.random.default_rng([seed, 0]))
    return hall if session == 0 else with_lamps_off(hall, np.random.default_rng([seed, 0, session]))


@lru_cache(maxsize=2)
def _scene(ceiling: str, seed: int, session: int, focal_px: float, with_floor: bool) -> Scene:
    hall = _hall(ceiling, seed, session)
    if with_floor:
        hall = replace(hall, surfaces=[*hall.surfaces, structures.floor(*hall.size_m)])
    return build_scene(hall, focal_px, seed)


def random_stream(seed: int, *stream: Union[str, int]) -> np.random.Generator:
    """A random generator for each purpose, so that the numbers do not depend on what else is simulated."""
    words = [list(word.encode()) if isinstance(word, str) else [word] for word in stream]
    return np.random.default_rng([seed, *(number for word in words for number in word)])


def stream_of(config: SimulationConfig, *stream: Union[str, int]) -> np.random.Generator:
    """A random generator for a purpose in a drive; each session has its own."""
    return random_stream(config.seed, *stream, *(("session", config.session) if config.session else ()))


class World:
    """A robot that moves under a ceiling.

    Attributes:
        config: the settings.
        events: the events with their times.
        robot: the true robot and its motion.
    """

    def __init__(self, config: SimulationConfig, motion: BaseMotion, events: List[Event]) -> None:
        self.config = config
        self.events = events
        tones = Robot.random_tones(self.rng("vibration"))
        self.robot = Robot(motion, config.wheels.applied(NOMINAL), config.vibration, events, tones)
        self.exposure = ExposureControl(config.camera, events, self.rng("exposure"))

    def rng(self, *stream: Union[str, int]) -> np.random.Generator:
        """See stream_of."""
        return stream_of(self.config, *stream)

    @property
    def nominal(self) -> RobotDescription:
        """The robot with its nominal dimensions."""
        return NOMINAL

    @property
    def hall(self) -> Hall:
        """The building."""
        return hall_of(self.config)

    def obstacles_around(self, motion: BaseMotion, duration_s: float) -> Obstacles:
        """What stands and moves on the floor; traffic keeps away from a robot that moves so for a time."""
        hall, time_s = self.hall, np.arange(0.0, duration_s, TRAFFIC_STEP_S)
        robot = motion.poses(time_s)[:, :2]
        traffic = draw_traffic(self.rng("traffic"), hall.size_m, self.config.traffic, time_s, robot)
        return replace(hall.obstacles, movers=(*hall.obstacles.movers, *traffic))

    @property
    def scene(self) -> Scene:
        """The building ready for rendering; takes seconds the first time."""
        return _scene(
            self.config.ceiling, self.config.seed, self.config.session, self.config.camera.lens.fx, self.config.forward
        )

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
    def renderer(self) -> Renderer:
        """Renders the scene for the cameras."""
        return Renderer(self.scene, self.config.camera.pinhole)

    def images_at(self, time_s: float, index: int) -> CameraFrame:
        """The images of all cameras, exposed around time_s; the index is that of their noise."""
        exposure_ms = self.exposure.exposure_ms(time_s)
        gain = flicker_factor(self.events, time_s, exposure_ms * 1e-3) * light_level(self.events, np.array([time_s]))[0]
        images = {}
        for number, (name, T_base_camera) in enumerate(self.cameras.items()):
            light = self.light(time_s, exposure_ms, T_base_camera) * np.float32(gain)
            if number == 0:
                light = covered_light(self.events, time_s, light)
            images[name] = self.config.camera.develop(light, self.rng("noise", number, index))
        told_ms = exposure_ms if self.config.exposures_told else None
        return CameraFrame(self.image_stamp_ns(time_s), time_s, told_ms, images)

    def light(self, time_s: float, exposure_ms: float, T_base_camera: np.ndarray) -> np.ndarray:
        """Light that a camera receives while all lamps are on, (H, W) float32, where 1 saturates.

        Args:
            time_s: the middle of the exposure.
            exposure_ms: exposure time.
            T_base_camera: (4, 4) mount of the camera.
        """
        T_world_base = self.robot.T_world_base(time_s + SAMPLE_TIMES * exposure_ms * 1e-3)
        radiance = self.config.camera.distort(self.renderer.expose(T_world_base @ T_base_camera))
        return radiance * np.float32(exposure_ms / REFERENCE_EXPOSURE_MS)

    def inverse_depth(self, time_s: float) -> np.ndarray:
        """True 1/z of the upward camera at time_s, (H, W) float32 in 1/m of its pinhole image."""
        return self.renderer.inverse_depth(self.robot.T_world_camera(np.array([time_s]))[0])


def hall_of(config: SimulationConfig) -> Hall:
    """The building of a drive."""
    return _hall(config.ceiling, config.seed, config.session)
