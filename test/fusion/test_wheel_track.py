# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.dso.durations import nanoseconds
from ceiling_dso_ros.fusion.config import WheelConfig
from ceiling_dso_ros.fusion.wheel_motion import WheelMotion, WheelNoise, WheelStep
from ceiling_dso_ros.fusion.wheel_track import WheelTrack

NOISE = WheelNoise(WheelConfig(), 0.5, 1e-4)


def filled(seconds, horizon_s=10.0):
    track = WheelTrack(NOISE, horizon_s)
    steps = [
        WheelStep(k * 20_000_000, (k + 1) * 20_000_000, np.array([0.02, 0.0, 0.01 * np.sin(k)]))
        for k in range(int(seconds * 50))
    ]
    for step in steps:
        track.add(step)
    return track, steps


def motion_over(steps, start_s, end_s):
    start_ns, end_ns = nanoseconds(start_s), nanoseconds(end_s)
    motion = WheelMotion.nothing(start_ns)
    for step in steps:
        part = step.clip(start_ns, end_ns)
        if part is not None:
            motion = NOISE.extend(motion, part)
    return motion


def test_motion_between_two_stamps_cuts_the_outer_steps():
    track, steps = filled(4.0)
    expected = motion_over(steps, 1.013, 2.991)
    found = track.motion(nanoseconds(1.013), nanoseconds(2.991))
    np.testing.assert_allclose(found.pose, expected.pose, atol=1e-12)
    np.testing.assert_allclose(found.noise, expected.noise, atol=1e-12)
    assert found.end_ns == 2_991_000_000


def test_the_motion_since_the_mark_outlives_the_horizon():
    track, steps = filled(30.0, horizon_s=2.0)
    np.testing.assert_allclose(track.since_mark(nanoseconds(29.5)).pose, motion_over(steps, 0.0, 29.5).pose, atol=1e-9)
    track.mark(nanoseconds(29.5), np.zeros(2))
    np.testing.assert_allclose(track.since_mark(nanoseconds(29.9)).pose, motion_over(steps, 29.5, 29.9).pose, atol=1e-9)


@pytest.mark.parametrize("horizon_s", [2.0, 20.0])
def test_the_corrected_motion_is_that_of_corrected_steps_however_old(horizon_s):
    constants, (_, steps) = np.array([0.02, -0.01]), filled(15.0)
    track = WheelTrack(NOISE, horizon_s)
    for step in steps:
        track.add(step)
        if step.end_ns == 2_500_000_000:
            track.mark(nanoseconds(2.5), constants)
    expected = motion_over([NOISE.corrected(step, constants) for step in steps], 2.5, 14.9)
    found = track.corrected_since_mark(nanoseconds(14.9))
    np.testing.assert_allclose(found.pose, expected.pose, atol=1e-9)
    np.testing.assert_allclose(found.noise, expected.noise, atol=1e-9)
    assert abs(found.pose[2] - track.since_mark(nanoseconds(14.9)).pose[2]) > 0.4


def test_turns_up_to_stamps_are_those_of_the_motions():
    track, _ = filled(15.0)
    stamps_ns = np.array([track.start_ns, nanoseconds(7.013), nanoseconds(12.991), track.end_ns])
    motions = [track.motion(track.start_ns, int(stamp_ns)) for stamp_ns in stamps_ns]
    np.testing.assert_allclose(track.turned(stamps_ns), [motion.pose[2] for motion in motions], atol=1e-12)


def test_memory_is_bounded_while_no_mark_is_set():
    track, _ = filled(60.0, horizon_s=2.0)
    assert len(track.steps(0, nanoseconds(60.0))) <= 2 * 50 + 1


@pytest.mark.parametrize("stamp_s", [10.0, 31.0])
def test_a_stamp_that_is_forgotten_or_still_to_come_has_no_motion(stamp_s):
    track, _ = filled(30.0, horizon_s=2.0)
    assert track.since_mark(nanoseconds(stamp_s)) is None


def test_without_steps_there_is_no_motion():
    track = WheelTrack(NOISE)
    assert track.empty
    assert track.since_mark(nanoseconds(0.0)) is None
