# SPDX-License-Identifier: BSD-3-Clause
"""A drive whose commands come while it goes on: time advances step by step, and each step gives what was measured."""

from typing import Iterator, List

import numpy as np

from ceiling_dso_ros.simulation.camera import frame_jitter_s
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.driving.commanded import STEP_S, CommandedMotion
from ceiling_dso_ros.simulation.driving.sequences import drawn_sequence
from ceiling_dso_ros.simulation.events import Event, EventError, is_dropped, parse_events, parse_live_event
from ceiling_dso_ros.simulation.robot import NOMINAL
from ceiling_dso_ros.simulation.sensors.encoders import WHEEL_HZ, EncoderPair
from ceiling_dso_ros.simulation.sensors.laser import SCAN_HZ, SWEEP_S, LaserScanner
from ceiling_dso_ros.simulation.sensors.measurements import (
    CameraFrame,
    Measurement,
    ScanReading,
    WheelReading,
    stamp_ns,
)
from ceiling_dso_ros.simulation.world import World, hall_of, stream_of

# From the middle of an exposure, which takes 14 ms at most, to the image: then all of the exposure is past.
IMAGE_DELAY_S = 0.01


class ClosedLoop(World):
    """A robot that drives as it is commanded, under one ceiling.

    The same commands at the same steps give the same measurements.

    Attributes:
        duration_s: when the drive ends; inf if it does not.
        motion: of the base.
    """

    motion: CommandedMotion

    def __init__(self, config: SimulationConfig) -> None:
        """Place the robot where the sequence of the settings starts.

        Raises:
            ConfigError: a setting is out of range.
            EventError: an event is none, or says no time in a drive without an end.
        """
        config.check()
        self.duration_s = config.duration_s or np.inf
        events = [_without_carrying(event) for event in parse_events(config.events, self.duration_s)]
        start = drawn_sequence(config.sequence, stream_of(config, "start")).start
        true = config.wheels.applied(NOMINAL)
        self.motion = CommandedMotion(start, NOMINAL, true, events, hall_of(config).obstacles)
        super().__init__(config, self.motion, events)
        self._encoders = EncoderPair(true, config.wheels, self.rng("wheels"))
        self._scanner = LaserScanner(self.hall.obstacles, self.rng("scan"), config.laser)
        self._frame_rng = self.rng("frames")
        self._wheel_count, self._scan_count, self._frame_count = 0, 0, 0
        self._frame_s = self._next_frame_s()
        self._first_ticks = self._encoders.read(np.zeros(1), *self.motion.wheel_ways_m(np.zeros(1))).ticks[0]

    @property
    def now_s(self) -> float:
        """Time since the start."""
        return self.motion.now_s

    def command(self, speed_m_s: float, yaw_rate_rad_s: float) -> None:
        """See CommandedMotion."""
        self.motion.command(speed_m_s, yaw_rate_rad_s)

    def add_event(self, text: str) -> Event:
        """Let something happen, now or at a time to come.

        Args:
            text: as `events.parse_live_event` takes it.

        Raises:
            EventError: the text is no event.
        """
        event = _without_carrying(parse_live_event(text, self.now_s, self.events))
        self.events.append(event)
        self.events.sort(key=lambda each: each.start_s)
        return event

    def step(self) -> List[Measurement]:
        """Move on by STEP_S; returns what has been measured, ordered by the time at which it is ready."""
        self.motion.step()
        return [*self._wheel_readings(), *self._scans(), *self._frames()]

    def _wheel_readings(self) -> Iterator[WheelReading]:
        while (time_s := (self._wheel_count + 1) / WHEEL_HZ) <= self._until_s:
            self._wheel_count += 1
            times = np.array([time_s])
            reading = self._encoders.read(times, *self.motion.wheel_ways_m(times))
            (angles,) = reading.angles_rad(NOMINAL.ticks_per_turn, self._first_ticks)
            yield WheelReading(stamp_ns(time_s), reading.counters[0], angles, self.robot.T_world_base(times)[0])

    def _scans(self) -> Iterator[ScanReading]:
        while (start_s := self._scan_count / SCAN_HZ) + SWEEP_S <= self._until_s:
            self._scan_count += 1
            yield ScanReading(stamp_ns(start_s), self._scanner.sweep(self.motion, start_s))

    def _frames(self) -> Iterator[CameraFrame]:
        while self._frame_s + IMAGE_DELAY_S <= self._until_s:
            time_s, index = self._frame_s, self._frame_count
            self._frame_count += 1
            self._frame_s = self._next_frame_s()
            if not is_dropped(self.events, time_s, self._frame_rng):
                yield self.images_at(time_s, index)

    @property
    def _until_s(self) -> float:
        """Everything up to then is past; sums of floats may differ a little."""
        return self.now_s + STEP_S * 1e-6

    def _next_frame_s(self) -> float:
        return float((self._frame_count + 1) / self.config.camera.fps + frame_jitter_s(self._frame_rng, 1)[0])


def _without_carrying(event: Event) -> Event:
    """The event.

    Raises:
        EventError: the robot would be carried: to where the rest of its drive fits must be known before.
    """
    if event.kind == "kidnap":
        raise EventError("'kidnap': only a planned drive can go on elsewhere")
    return event
