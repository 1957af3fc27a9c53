# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.dso.durations import nanoseconds, seconds
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.config import WheelConfig
from ceiling_dso_ros.fusion.relative_filter import RelativeFilter, Sighting
from ceiling_dso_ros.fusion.wheel_motion import WheelNoise, WheelStep

NOISE = WheelNoise(WheelConfig(noise_m_per_sqrt_m=0.002), 0.5, 1e-4)
CONSTANTS = np.diag([0.01, 0.01]) ** 2
R = np.diag([7e-4, 7e-4, 3e-4]) ** 2


def wheel_steps(count, rate=(0.8, 0.0, 0.3)):
    return [WheelStep(k * 20_000_000, (k + 1) * 20_000_000, np.array(rate) / 50) for k in range(count)]


def started(events=()):
    live = RelativeFilter(NOISE, 0, CONSTANTS)
    live.restart(0, np.zeros(2), CONSTANTS, list(events))
    return live


def test_without_images_it_is_dead_reckoning():
    live = started(wheel_steps(40))
    np.testing.assert_allclose(live.state.pose, planar.expmap([0.64, 0.0, 0.24]), atol=1e-9)
    assert live.state.stamp_ns == 800_000_000


def test_a_late_image_gives_what_it_would_have_given_in_time():
    sighting = Sighting(417_000_000, planar.expmap(0.417 * np.array([0.81, 0.0, 0.31])), R)
    late = started(wheel_steps(40))
    assert late.correct(sighting)
    steps = wheel_steps(40)
    in_time = started(steps[:21])
    in_time.correct(sighting)
    for step in steps[21:]:
        in_time.predict(step)
    np.testing.assert_allclose(late.state.pose, in_time.state.pose, atol=1e-12)
    np.testing.assert_allclose(late.state.covariance, in_time.state.covariance, atol=1e-15)


def test_images_in_any_order_give_the_same():
    sightings = [Sighting(nanoseconds(s), planar.expmap(s * np.array([0.81, 0.0, 0.31])), R) for s in (0.2, 0.37, 0.5)]
    forth, back = started(wheel_steps(40)), started(wheel_steps(40))
    for sighting in sightings:
        forth.correct(sighting)
    for sighting in sightings[::-1]:
        back.correct(sighting)
    np.testing.assert_allclose(back.state.pose, forth.state.pose, atol=1e-9)


def test_an_image_from_before_the_keyframe_or_the_future_is_refused():
    live = started(wheel_steps(10))
    assert not live.correct(Sighting(-100_000_000, np.zeros(3), R))
    assert not live.correct(Sighting(500_000_000, np.zeros(3), R))


def test_images_teach_it_the_wheels_constants():
    live = started()
    for step in wheel_steps(50, rate=(0.8, 0.0, 0.0)):
        live.predict(step)
        live.correct(Sighting(step.end_ns, np.array([0.8, 0.0, 0.016]) * seconds(step.end_ns), R))
    assert live.state.constants[0] == pytest.approx(0.01, abs=0.004)  # turns 0.02 rad a metre: 1 % of ratio at 0.5 m


def test_its_error_is_as_large_as_it_says():
    rng = np.random.default_rng(3)
    nees = []
    for _ in range(200):
        live = started()
        ratio, base = 0.01 * rng.normal(size=2)
        true, twist = np.zeros(3), np.array([0.016, 0.0, 0.006])
        for index in range(40):
            step = WheelStep(index * 20_000_000, (index + 1) * 20_000_000, twist)
            noise = np.linalg.cholesky(NOISE.white(step) + 1e-18 * np.eye(3)) @ rng.normal(size=3)
            by_constants = NOISE.sensitivity(twist)[:, 1:] @ [ratio, base]
            true = planar.compose(true, planar.expmap(twist + by_constants + noise))
            live.predict(step)
            if index % 5 == 4 and index < 25:
                seen = planar.compose(true, np.sqrt(np.diag(R)) * rng.normal(size=3))
                live.correct(Sighting(step.end_ns, seen, R))
        error = planar.between(live.state.pose, true)
        nees.append(error @ np.linalg.solve(live.state.covariance[:3, :3], error))
    assert 2.6 < np.mean(nees) < 3.4


def test_wheels_that_contradict_an_image_are_not_believed():
    live = started(wheel_steps(10, rate=(0.8, 0.0, 1.5)))
    seen = np.array([0.16, 0.0, 0.0])
    live.correct(Sighting(200_000_000, seen, R))
    np.testing.assert_allclose(live.state.pose, seen, atol=2e-3)


def test_its_memory_is_bounded():
    live = started()
    for step in wheel_steps(5000):
        live.predict(step)
    assert len(live._entries) <= 52
