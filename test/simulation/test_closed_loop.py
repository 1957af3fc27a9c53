# SPDX-License-Identifier: BSD-3-Clause

import numpy as np
import pytest

from ceiling_dso_ros.dso.config import ConfigError
from ceiling_dso_ros.fusion.config import RobotModel, WheelConfig
from ceiling_dso_ros.fusion.wheel import WheelOdometry
from ceiling_dso_ros.simulation.camera import CameraModel
from ceiling_dso_ros.simulation.closed_loop import ClosedLoop
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.driving.commanded import STEP_S
from ceiling_dso_ros.simulation.events import EventError
from ceiling_dso_ros.simulation.robot import Vibration
from ceiling_dso_ros.simulation.sensors.measurements import START_NS, CameraFrame, ScanReading, WheelReading
from ceiling_dso_ros.simulation.world import World

TINY = CameraModel(width=104, height=64, fps=20.0)


def loop(**settings):
    return ClosedLoop(SimulationConfig("straight", "plaster", **{"camera": TINY, **settings}))


def driven(simulation, seconds, speed=0.0, yaw_rate=0.0):
    """All measurements, and the time at which each was ready."""
    found = []
    for _ in range(round(seconds / STEP_S)):
        simulation.command(speed, yaw_rate)
        found += [(simulation.now_s, measurement) for measurement in simulation.step()]
    return found


def of(kind, found):
    return [measurement for _, measurement in found if isinstance(measurement, kind)]


@pytest.fixture
def without_images(monkeypatch):
    monkeypatch.setattr(
        World, "images_at", lambda self, time_s, index: CameraFrame(START_NS + round(1e9 * time_s), time_s, 5.0, {})
    )


def test_sensors_measure_at_their_rates_and_nothing_from_the_future(without_images):
    found = driven(loop(), 3.0, 0.5)
    assert [len(of(kind, found)) for kind in (WheelReading, CameraFrame, ScanReading)] == pytest.approx(
        [150, 60, 29], abs=1
    )
    for kind in (WheelReading, CameraFrame, ScanReading):
        stamps = [measurement.stamp_ns for measurement in of(kind, found)]
        assert stamps == sorted(set(stamps))
    for now_s, measurement in found:
        age_s = now_s - 1e-9 * (measurement.stamp_ns - START_NS)
        assert -1e-9 < age_s < 0.1


def test_the_same_commands_give_the_same_measurements():
    one, two = (driven(loop(duration_s=2.0), 0.4, 0.5, 0.3) for _ in range(2))
    assert len(one) == len(two)
    for (_, a), (_, b) in zip(one, two):
        assert a.stamp_ns == b.stamp_ns
        if isinstance(a, CameraFrame):
            np.testing.assert_array_equal(a.image, b.image)
        else:
            np.testing.assert_array_equal(a[1], b[1])


def test_images_move_with_the_robot():
    still, moving = (
        of(CameraFrame, driven(loop(vibration=Vibration(0, 0, 0)), 1.0, 0.0, yaw_rate)) for yaw_rate in (0.0, 1.0)
    )

    def change(frames):
        return np.abs(
            frames[-1].image.astype(float) - frames[0].image * (frames[-1].exposure_ms / frames[0].exposure_ms)
        ).mean()

    assert change(moving) > 2 * change(still)


def test_dead_reckoning_with_the_true_robot_finds_its_way(without_images):
    simulation = loop()
    true = simulation.robot.true
    model = RobotModel(true.T_base_camera, true.wheel_base_m, true.wheel_radius_m, true.ticks_per_turn)
    odometry, start = WheelOdometry(model, WheelConfig()), simulation.motion.poses(np.zeros(1))[0]
    for reading in of(WheelReading, driven(simulation, 2.0, 0.8) + driven(simulation, 3.0, 0.4, -0.5)):
        odometry.add_ticks(reading.stamp_ns, *(int(counter) for counter in reading.counters))
    x, y, yaw = odometry.total.pose
    c, s = np.cos(start[2]), np.sin(start[2])
    end = simulation.motion.poses(np.array([simulation.now_s]))[0]
    np.testing.assert_allclose([start[0] + c * x - s * y, start[1] + s * x + c * y, start[2] + yaw], end, atol=0.01)


def test_wheel_angles_and_counters_say_the_same(without_images):
    readings = of(WheelReading, driven(loop(), 3.0, 0.5))
    turned = np.array([reading.angles_rad for reading in readings])
    counted = np.diff([reading.counters for reading in readings], axis=0)
    np.testing.assert_allclose(
        np.diff(turned, axis=0), (counted + 2**31) % 2**32 * (2 * np.pi / 4096) - np.pi * 2**32 / 4096
    )
    assert (np.abs(turned[0]) < 0.01).all()


def test_events_may_come_while_it_drives():
    simulation = loop(events=("lights_off@1.0",))
    plain = of(CameraFrame, driven(simulation, 0.5))
    event = simulation.add_event("cover+0.6")
    assert (event.kind, event.start_s, event.duration_s) == ("cover", pytest.approx(0.5), 0.6)
    simulation.add_event("slip@2.0+0.3")
    covered = of(CameraFrame, driven(simulation, 0.5))
    dark = of(CameraFrame, driven(simulation, 0.5))
    assert covered[-1].image.mean() < 0.2 * plain[-1].image.mean()
    assert 0.05 < dark[-1].image.mean() / plain[-1].image.mean() < 0.7
    assert dark[-1].exposure_ms > plain[-1].exposure_ms
    driven(simulation, 1.5, 0.4)
    _, slipped = simulation.motion.wheel_ways_m(np.array([simulation.now_s]))
    assert slipped[0, 0] > 0.03


@pytest.mark.parametrize("text", ["", "fire", "slip@", "slip@0.1", "lights_on", "slip+x", "slip+0"])
def test_what_cannot_happen_is_told_in_one_line(text, without_images):
    simulation = loop()
    driven(simulation, 0.5)
    with pytest.raises(EventError) as info:
        simulation.add_event(text)
    assert "\n" not in str(info.value)
    assert simulation.events == []


def test_an_event_without_a_time_needs_a_drive_with_an_end():
    with pytest.raises(EventError, match="@START"):
        loop(events=("slip",))
    assert len(loop(events=("slip",), duration_s=20.0).events) == 3
    with pytest.raises(ConfigError):
        loop(duration_s=-1.0)


def test_lost_images_are_none(without_images):
    counts = [len(of(CameraFrame, driven(loop(events=events), 2.0))) for events in ((), ("drop_frames@0.1+1.5",))]
    assert counts[1] < 0.6 * counts[0]
    assert counts[1] > 5
