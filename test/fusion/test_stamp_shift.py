# SPDX-License-Identifier: BSD-3-Clause
"""Stamps of images that come to be late or early are found by the turns of camera and wheels."""

import numpy as np
import pytest

from ceiling_dso_ros.fusion.config import WheelConfig
from ceiling_dso_ros.fusion.stamp_shift import WORTH_S, StampShift, shift_of_turns
from ceiling_dso_ros.fusion.wheel_motion import WheelNoise, WheelStep
from ceiling_dso_ros.fusion.wheel_track import WheelTrack

BEGIN_NS, TICK_RAD = 10**18, 2e-4
SLIP = 0.03  # of a turn, by the wheels


def stop_and_turn(rate_rad_s, seed=0, ramp_s=0.4):
    """Yaw of a robot that drives straight on and turns, for random times, as a function of seconds."""
    rng = np.random.default_rng(seed)
    times_s, rates = [0.0], [0.0]
    while times_s[-1] < 120.0:
        turn = rng.choice([-1.0, 1.0]) * rate_rad_s * rng.uniform(0.6, 1.0)
        for rate in (turn, 0.0):
            hold_s = rng.uniform(1.0, 4.0)
            times_s += [times_s[-1] + hold_s, times_s[-1] + hold_s + ramp_s]
            rates += [rates[-1], rate]
    fine_s = np.arange(0.0, times_s[-1], 0.001)
    yaw = np.concatenate([[0.0], np.cumsum(np.interp(fine_s, times_s, rates))[:-1]]) * 0.001
    return lambda t_s: np.interp(t_s, fine_s, yaw)


def followed(yaw, late_s, wheel_s=0.02, image_s=1 / 30.0, duration_s=60.0, seed=0, slip=SLIP, lost=(), known=True):
    """The late_s that was found after each image of a drive; late_s: seconds, or a function of the stamp."""
    rng, found = np.random.default_rng(seed), []
    track, shift = WheelTrack(WheelNoise(WheelConfig(), 0.5, 1e-4)), StampShift()
    wheels_s = np.arange(0.0, duration_s, wheel_s)
    counted = np.rint((1.0 + slip) * yaw(wheels_s) / TICK_RAD) * TICK_RAD  # encoders count in ticks
    images_s = np.arange(1.0, duration_s, image_s) + 1e-3 * rng.normal(size=np.arange(1.0, duration_s, image_s).size)
    late = late_s(images_s) if callable(late_s) else late_s
    seen = yaw(images_s - late) + 3e-4 * rng.normal(size=images_s.size)
    k = 1
    for start_s, end_s, before, after in zip(images_s, images_s[1:], seen, seen[1:]):
        while k < wheels_s.size and wheels_s[k] <= end_s:
            span_ns = (BEGIN_NS + round(1e9 * wheels_s[k - 1]), BEGIN_NS + round(1e9 * wheels_s[k]))
            track.add(WheelStep(*span_ns, np.array([0.02, 0.0, counted[k] - counted[k - 1]]), known))
            k += 1
        if not any(first_s < end_s < last_s for first_s, last_s in lost):
            shift.add(BEGIN_NS + round(1e9 * start_s), BEGIN_NS + round(1e9 * end_s), after - before, track)
        found.append(shift.late_s)
    return np.array(found)


@pytest.mark.parametrize("late_s", [-0.25, -0.08, -0.05, 0.05, 0.06, 0.133, 0.25])
@pytest.mark.parametrize("rate", [0.3, 0.8])
def test_late_and_early_stamps_are_found(late_s, rate):
    found = followed(stop_and_turn(rate), late_s)
    assert found[-1] == pytest.approx(late_s, abs=0.01)
    known = found[found != 0.0]
    assert np.abs(known - late_s).max() < 0.01  # never another one


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("late_s", [0.0, 0.01, -0.02])
@pytest.mark.parametrize(("wheels_hz", "images_hz"), [(50.0, 30.0), (100.0, 15.0), (20.0, 30.0), (50.0, 6.0)])
def test_stamps_that_are_right_are_not_blamed(seed, late_s, wheels_hz, images_hz):
    assert not followed(stop_and_turn(0.8, seed), late_s, 1.0 / wheels_hz, 1.0 / images_hz, seed=seed).any()


def test_a_steady_turn_and_a_straight_way_tell_nothing():
    for yaw in (lambda t_s: 0.5 * t_s, lambda t_s: 1e-4 * np.sin(t_s)):
        assert not followed(yaw, 0.2).any()


@pytest.mark.parametrize("own", [True, False])
def test_wheels_that_turn_otherwise_are_no_clock(own):
    """A window is judged only where the wheels, shifted, explain what the camera sees."""
    yaw = stop_and_turn(0.8)
    of_wheels = yaw if own else stop_and_turn(0.8, seed=5)
    track = WheelTrack(WheelNoise(WheelConfig(), 0.5, 1e-4))
    for k in range(500):
        span_ns = BEGIN_NS + 20_000_000 * k, BEGIN_NS + 20_000_000 * (k + 1)
        turn = of_wheels(0.02 * (k + 1)) - of_wheels(0.02 * k)
        track.add(WheelStep(*span_ns, np.array([0.02, 0.0, turn])))
    found = []
    for first_s in np.arange(1.0, 6.0, 0.5):
        images_s = np.arange(first_s, first_s + 3.0, 1 / 30.0)
        found.append(shift_of_turns(BEGIN_NS + np.rint(1e9 * images_s).astype(np.int64), yaw(images_s - 0.1), track))
    known = [late_s for late_s in found if late_s is not None]
    assert bool(known) == own
    assert known == pytest.approx([0.1] * len(known), abs=0.01)


def test_a_clock_that_creeps_is_found():
    found = followed(stop_and_turn(0.8), lambda t_s: 2e-3 * t_s, duration_s=100.0)
    at_s = 1.0 + np.arange(found.size) / 30.0
    assert not found[at_s < 10.0].any()  # 20 ms
    assert found[-1] == pytest.approx(0.2, abs=0.04)  # that of the last turns, of the last half minute


def test_stamps_that_are_right_again_are_forgiven():
    found = followed(stop_and_turn(0.8), lambda t_s: np.where(t_s < 40.0, 0.1, 0.0), duration_s=100.0)
    at_s = 1.0 + np.arange(found.size) / 30.0
    assert found[at_s < 40.0].max() == pytest.approx(0.1, abs=0.01)
    assert found[-1] == 0.0


def test_wheels_that_only_guess_or_seldom_count_tell_no_time():
    """What bridges their silence comes from the images, by a filter that lags."""
    assert not followed(stop_and_turn(0.8), 0.1, known=False).any()
    assert not followed(stop_and_turn(0.8), 0.1, wheel_s=0.25).any()


def test_gaps_between_images_only_delay_it():
    found = followed(stop_and_turn(0.8), 0.1, lost=[(5.0 * k, 5.0 * k + 0.5) for k in range(4)])
    assert found[-1] == pytest.approx(0.1, abs=0.01)


def test_the_other_pose_is_where_the_robot_was_then():
    shift = StampShift()
    assert shift.other_pose(np.zeros(3), np.array([1.0, 0.5])) is None
    shift._judgments_s.extend([0.1, 0.1, 0.11])
    other = shift.other_pose(np.array([2.0, 1.0, np.pi / 2]), np.array([1.0, 0.0]))
    np.testing.assert_allclose(other, [2.0, 1.1, np.pi / 2], atol=1e-9)
    assert shift.late_s > WORTH_S
