# SPDX-License-Identifier: BSD-3-Clause
import itertools

import cv2
import numpy as np
import pytest

from ceiling_dso_ros.dso.config import ConfigError
from ceiling_dso_ros.simulation.camera import CameraModel
from ceiling_dso_ros.simulation.ceilings import CEILINGS
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.events import EventError
from ceiling_dso_ros.simulation.sensors.measurements import CameraFrame, ImuReading, ScanReading, WheelReading
from ceiling_dso_ros.simulation.simulation import Simulation, simulate

SMALL = CameraModel(width=212, height=120)
TINY = CameraModel(width=104, height=64)
DEPTH_EDGE_M = 0.05
BORDER_PX = 3
SATURATED = 250


def config(sequence="straight", ceiling="plaster", **settings):
    return SimulationConfig(sequence, ceiling, **{"camera": TINY, **settings})


class Warp:
    """Where the pixels of one frame lie in an earlier one, by true depth and pose, and which can be compared."""

    def __init__(self, simulation, first, second):
        camera = simulation.config.camera.pinhole
        times = simulation.frame_times_s[[first, second]]
        T_first, T_second = simulation.robot.T_world_camera(times)
        T = np.linalg.inv(T_first) @ T_second
        self.depths = [1 / simulation.inverse_depth(time_s) for time_s in times]
        x, y = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
        rays = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones(x.shape)], axis=-1)
        points = (rays * self.depths[1][..., None]) @ T[:3, :3].T + T[:3, 3]
        self.u = camera.fx * points[..., 0] / points[..., 2] + camera.cx
        self.v = camera.fy * points[..., 1] / points[..., 2] + camera.cy
        low, right, bottom = BORDER_PX, camera.width - 1 - BORDER_PX, camera.height - 1 - BORDER_PX
        self.usable = (self.u > low) & (self.u < right) & (self.v > low) & (self.v < bottom)
        nearest = np.rint(self.v[self.usable]).astype(int), np.rint(self.u[self.usable]).astype(int)
        hidden = np.abs(self.depths[0][nearest] - points[..., 2][self.usable]) > DEPTH_EDGE_M
        at_edge = self.near_edge(self.depths[0])[nearest] | self.near_edge(self.depths[1])[self.usable]
        self.usable[self.usable] = ~(hidden | at_edge)

    @staticmethod
    def near_edge(depth):
        """Within a pixel or two of a jump in depth; slopes of surfaces do not count."""
        bend = np.abs(cv2.Laplacian(1 / depth.astype(np.float32), cv2.CV_32F, ksize=1)) * depth**2
        return cv2.dilate((bend > DEPTH_EDGE_M).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0

    def compare(self, first, second, gain):
        """Residuals second - gain * warped first, warped levels, and the share of their noise that is left, (n,)."""
        u, v = self.u[self.usable], self.v[self.usable]
        i, j = u.astype(int), v.astype(int)
        p, q = u - i, v - j
        weights = np.stack([(1 - p) * (1 - q), p * (1 - q), (1 - p) * q, p * q])
        levels = np.stack([first[j, i], first[j, i + 1], first[j + 1, i], first[j + 1, i + 1]])
        dark = (np.maximum.reduce(levels) < SATURATED) & (second[self.usable] < SATURATED)
        warped = gain * (weights * levels).sum(axis=0)
        return (second[self.usable] - warped)[dark], warped[dark], (gain**2 * (weights**2).sum(axis=0))[dark]


def robust_deviation(values):
    return 1.4826 * np.median(np.abs(values - np.median(values)))


@pytest.mark.long
@pytest.mark.parametrize("ceiling", CEILINGS)
def test_frames_warped_by_the_truth_differ_by_the_noise_alone(ceiling):
    """The check that the renderer must pass: the same point has the same grey in all frames."""
    camera = CameraModel()
    simulation = Simulation(SimulationConfig("loops", ceiling, camera=camera))
    for first, gap in itertools.product((100, 900, 1500), (1, 5, 15)):
        warp = Warp(simulation, first, first + gap)
        frames = [simulation.frame(index) for index in (first, first + gap)]
        gain = frames[1].exposure_ms / frames[0].exposure_ms
        assert warp.usable.mean() > 0.4

        residual, level, share = warp.compare(*(frame.image.astype(float) for frame in frames), gain)
        rounding = 1 / 12
        sigma = np.sqrt(camera.noise_sigma(level) ** 2 + rounding + share * (camera.noise_sigma(level) ** 2 + rounding))
        assert abs(np.median(residual)) < 0.1
        assert robust_deviation(residual / sigma) == pytest.approx(1.0, abs=0.15)

        mount = simulation.cameras["camera_up_optical_frame"]
        lights = [255 * simulation.light(frame.time_s, frame.exposure_ms, mount) for frame in frames]
        residual, _, _ = warp.compare(*lights, gain)
        assert abs(np.median(residual)) < 0.1
        assert robust_deviation(residual) < 0.5


def test_the_same_seed_gives_the_same_bytes_and_another_one_does_not():
    one, two, other = ([*simulate("straight", "plaster", seed, camera=TINY, duration_s=0.7)] for seed in (3, 3, 4))
    assert len(one) == len(two)
    for a, b in zip(one, two):
        assert type(a) is type(b) and a.stamp_ns == b.stamp_ns
        if isinstance(a, CameraFrame):
            assert a.exposure_ms == b.exposure_ms
            np.testing.assert_array_equal(a.image, b.image)
        if isinstance(a, WheelReading):
            np.testing.assert_array_equal(a.counters, b.counters)
    images = [next(m.image for m in run if isinstance(m, CameraFrame)) for run in (one, other)]
    assert (images[0] != images[1]).any()


def test_measurements_come_in_the_order_of_time_at_their_rates():
    measurements = [*simulate("straight", "plaster", camera=TINY, duration_s=3.0, imu=True)]
    stamps = [measurement.stamp_ns for measurement in measurements]
    assert stamps == sorted(stamps)
    counts = {kind: sum(isinstance(m, kind) for m in measurements) for kind in (CameraFrame, WheelReading, ScanReading)}
    assert counts[CameraFrame] == pytest.approx(90, abs=2)
    assert counts[WheelReading] == pytest.approx(150, abs=2)
    assert counts[ScanReading] == pytest.approx(30, abs=1)
    assert sum(isinstance(m, ImuReading) for m in measurements) == pytest.approx(600, abs=3)


def test_frames_in_a_row_are_those_taken_one_by_one():
    simulation = Simulation(config(duration_s=0.5))
    for index, frame in enumerate(simulation.frames()):
        alone = simulation.frame(index)
        np.testing.assert_array_equal(frame.image, alone.image)
        assert frame.stamp_ns == alone.stamp_ns
    assert index + 1 == len(simulation.frame_times_s)


def test_a_consumer_may_stop_early():
    frames = Simulation(config()).frames()
    next(frames)
    frames.close()


def test_what_is_simulated_besides_changes_nothing():
    plain, full = (Simulation(config(duration_s=0.5, imu=flag, stereo=flag, forward=False)) for flag in (False, True))
    np.testing.assert_array_equal(plain.frame(5).image, full.frame(5).image)
    np.testing.assert_array_equal(plain.encoders.ticks, full.encoders.ticks)


@pytest.mark.long
def test_further_cameras_see_the_same_hall():
    simulation = Simulation(config("loops", "factory", camera=SMALL, stereo=True, forward=True, duration_s=2.0))
    images = simulation.frame(30).images
    assert list(images) == ["camera_up_optical_frame", "camera_up_right_optical_frame", "camera_front_optical_frame"]
    up, right, front = (image.astype(float) for image in images.values())
    depth = np.median(1 / simulation.inverse_depth(simulation.frame_times_s[30]))
    disparity = round(SMALL.pinhole.fx * 0.095 / depth)
    assert np.median(np.abs(up[:, disparity:] - right[:, :-disparity])) < np.median(np.abs(up - right))
    assert front.std() > 5 and (front > 0).mean() > 0.9


def test_events_reach_the_images():
    events = ("cover@1+1", "lights_off@4", "drop_frames@6+1")
    simulation, plain = (Simulation(config(duration_s=8.0, events=e)) for e in (events, ()))

    def grey(simulation, time_s):
        return np.median(simulation.frame(int(np.searchsorted(simulation.frame_times_s, time_s))).image)

    assert grey(simulation, 0.5) == grey(plain, 0.5)
    assert grey(simulation, 1.6) < 0.1 * grey(plain, 1.6)
    assert grey(simulation, 4.35) < 0.6 * grey(plain, 4.35)
    assert grey(simulation, 4.35) < grey(simulation, 5.9), "the exposure follows"
    during = (simulation.frame_times_s >= 6) & (simulation.frame_times_s < 7)
    assert 0 < during.sum() < 15


def test_a_time_offset_shifts_only_the_stamps_of_images():
    on_time, late = (Simulation(config(duration_s=0.5, time_offset_s=offset)) for offset in (0.0, 0.02))
    one, two = on_time.frame(3), late.frame(3)
    assert two.stamp_ns - one.stamp_ns == 20_000_000
    np.testing.assert_array_equal(one.image, two.image)
    assert next(on_time.wheel_readings()).stamp_ns == next(late.wheel_readings()).stamp_ns


def test_nothing_is_rendered_for_wheels_and_poses(monkeypatch):
    monkeypatch.setattr(Simulation, "scene", property(lambda self: pytest.fail("renders")))
    simulation = Simulation(SimulationConfig("loops", duration_s=1800.0))
    assert len(simulation.encoders.ticks) > 89_000
    assert simulation.robot.T_world_camera(simulation.frame_times_s).shape == (len(simulation.frame_times_s), 4, 4)
    assert len([*itertools.islice(simulation.wheel_readings(), 10)]) == 10


def test_the_truth_tells_every_value():
    simulation = Simulation(config("loops", events=("slip@10",), time_offset_s=0.01, seed=5))
    truth = simulation.truth()
    assert truth["config"]["seed"] == 5
    assert truth["wheel_radius"] == list(simulation.robot.true.wheel_radius_m)
    assert truth["events"] == [{"kind": "slip", "start_s": 10.0, "duration_s": 0.5}]
    assert truth["path_m"] == pytest.approx(57.1, abs=0.2)
    assert truth["camera_time_offset_s"] == 0.01
    np.testing.assert_array_equal(truth["T_base_camera"], simulation.robot.true.T_base_camera)


@pytest.mark.parametrize(
    "settings",
    [
        {"sequence": "circle"},
        {"ceiling": "sky"},
        {"seed": -1},
        {"duration_s": -1.0},
        {"duration_s": float("nan")},
        {"duration_s": 0.1},
        {"time_offset_s": 3.0},
        {"camera": CameraModel(width=850)},
    ],
)
def test_impossible_settings_are_refused_in_one_line(settings):
    with pytest.raises(ConfigError) as info:
        Simulation(SimulationConfig(**settings))
    assert "\n" not in str(info.value)


def test_an_unknown_event_is_refused():
    with pytest.raises(EventError, match="earthquake"):
        Simulation(config(events=("earthquake",)))
