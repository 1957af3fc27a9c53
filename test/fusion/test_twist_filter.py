# SPDX-License-Identifier: BSD-3-Clause
"""The twist: without the wheels' ticks, without lag, without slips, and as certain as it says."""

import numpy as np
import pytest
from simulated_drive import RATE_HZ, Truth, simulate_drive, true_motion

from ceiling_dso_ros.dso.durations import nanoseconds, seconds
from ceiling_dso_ros.fusion.config import OutputConfig, WheelConfig
from ceiling_dso_ros.fusion.estimator import FusionEstimator
from ceiling_dso_ros.fusion.twist_filter import TwistFilter
from ceiling_dso_ros.fusion.wheel_motion import WheelNoise, WheelStep

NOISE = WheelNoise(WheelConfig(radius_sigma=0.01), 0.5, 1e-4)
STEP_NS = 20_000_000


def add_steps(twist, rates, first=0):
    """Add a step of each (forward m/s, turn rad/s); returns the time, nanoseconds."""
    for k, (forward, turn) in enumerate(rates, start=first):
        end_ns = (k + 1) * STEP_NS
        twist.advance(end_ns)
        twist.add_step(WheelStep(k * STEP_NS, end_ns, np.array([forward, 0.0, turn]) / 50))
    return end_ns


def test_the_twist_is_that_of_the_wheels_without_their_ticks():
    twist, noise = TwistFilter(OutputConfig(), NOISE), np.random.default_rng(0).normal(size=(200, 2))
    add_steps(twist, [0.8, 0.3] + noise * [0.005, 0.02])
    np.testing.assert_allclose(twist.twist, [0.8, 0.3], atol=0.02)
    assert (np.diag(twist.covariance) > 0).all()


def test_a_constant_acceleration_does_not_lag():
    """The mean over the last step is 10 ms old: 8 mm/s at 0.8 m/s^2."""
    twist = TwistFilter(OutputConfig(), WheelNoise(WheelConfig(noise_m_per_sqrt_m=1e-4), 0.5, 1e-5))
    middles_s = (np.arange(50) + 0.5) / 50
    end_ns = add_steps(twist, np.stack([0.8 * middles_s, 0.5 * middles_s], axis=1))
    np.testing.assert_allclose(twist.twist, np.array([0.8, 0.5]) * seconds(end_ns), atol=1e-3)


def test_a_late_image_is_compared_with_the_twist_of_its_own_time():
    """While the speed grows by 0.8 m/s^2, an image of 60 ms ago saw less than the speed now."""
    twist = TwistFilter(OutputConfig(), NOISE)
    middles_s = (np.arange(50) + 0.5) / 50
    end_ns = add_steps(twist, np.stack([0.8 * middles_s, np.zeros(50)], axis=1))
    before = twist.twist
    start_ns = end_ns - nanoseconds(0.093)
    middle_s = seconds(start_ns) + 0.5 * 0.033
    twist.add_rate(start_ns, end_ns - nanoseconds(0.06), np.array([0.8 * middle_s, 0.0]), np.eye(2) * 1e-8)
    np.testing.assert_allclose(twist.twist, before, atol=0.003)


@pytest.mark.parametrize("lost", [False, True])
def test_over_a_gap_in_the_samples_the_distance_of_the_wheels_is_believed(lost):
    """Their clock may have been set ahead: then they have hardly turned. Or samples are lost: then they have."""
    twist = TwistFilter(OutputConfig(), NOISE)
    end_ns = add_steps(twist, [(1.1, 0.7)] * 50)
    after_ns = end_ns + nanoseconds(0.32)
    moved_s = 0.32 if lost else 0.02
    twist.advance(after_ns)
    assert twist.add_step(WheelStep(end_ns, after_ns, moved_s * np.array([1.1, 0.0, 0.7])))
    np.testing.assert_allclose(twist.twist, [1.1, 0.7], atol=0.1)


def test_no_robot_jumps_to_another_speed_within_a_step():
    twist = TwistFilter(OutputConfig(), NOISE)
    add_steps(twist, [(0.8, 0.0)] * 50)
    add_steps(twist, [(1.6, 2.0)] * 2, first=50)
    np.testing.assert_allclose(twist.twist, [0.8, 0.0], atol=0.02)


def test_a_change_that_lasts_is_believed():
    twist = TwistFilter(OutputConfig(), NOISE)
    add_steps(twist, [(0.8, 0.0)] * 50)
    add_steps(twist, [(0.0, 0.0)] * 50, first=50)
    np.testing.assert_allclose(twist.twist, 0.0, atol=1e-3)


def test_what_slipping_wheels_said_can_be_withdrawn():
    with_slip, without = TwistFilter(OutputConfig(), NOISE), TwistFilter(OutputConfig(), NOISE)
    for twist in (with_slip, without):
        add_steps(twist, [(0.8, 0.0)] * 50)
    slip_ns = 50 * STEP_NS
    add_steps(with_slip, [(0.8 + 0.03 * k, 0.0) for k in range(5)], first=50)
    seen = (slip_ns, slip_ns + nanoseconds(0.033), np.array([0.79, 0.0]), np.eye(2) * 1e-4)
    with_slip.add_rate(*seen)
    assert with_slip.twist[0] > 0.83
    with_slip.withdraw_steps(slip_ns)
    without.advance(slip_ns + 5 * STEP_NS)
    without.add_rate(*seen)
    np.testing.assert_allclose(with_slip.twist, without.twist, atol=1e-12)
    np.testing.assert_allclose(with_slip.covariance, without.covariance, atol=1e-12)


def test_a_robot_that_stands_has_no_speed_whatever_the_images_say():
    twist = TwistFilter(OutputConfig(), NOISE)
    add_steps(twist, [(0.8, 0.3)] * 50)
    now_ns, rng = add_steps(twist, [(0.0, 0.0)] * 50, first=50), np.random.default_rng(0)
    for k in range(100, 150):
        now_ns = add_steps(twist, [(0.0, 0.0)], first=k)
        twist.add_rate(
            now_ns - nanoseconds(0.09), now_ns - nanoseconds(0.06), rng.normal(size=2) * 0.02, np.eye(2) * 4e-4
        )
        assert abs(twist.twist[0]) < 1e-3
    add_steps(twist, [(0.1, 0.0)] * 3, first=150)
    assert twist.twist[0] > 0.05  # and starts at once


def driven(name, slips=(), late_s=0.06):
    """Twists as published when images come late: times in seconds, (n, 2) twists and sigmas; (m, 2) true ones."""
    drive = simulate_drive(name, 40.0, 3, Truth(slips=slips))
    _, speed, turn = true_motion(name, 40.0)
    rng = np.random.default_rng(0)
    events = [(stamp_ns, 0, sample) for stamp_ns, *sample in drive.ticks]
    events += [(s.stamp_ns + nanoseconds(late_s * rng.uniform(1.0, 1.3)), 1, s) for s in drive.statuses]
    estimator, states = FusionEstimator(drive.robot), []
    for stamp_ns, is_camera, data in sorted(events, key=lambda event: event[:2]):
        if is_camera:
            estimator.add_keyframes(data)
            estimator.add_frame(data)
        else:
            states.append(estimator.add_wheel_ticks(stamp_ns, *data))
    states = [state for state in states if state is not None and state.stamp_ns > drive.stamps[0] + nanoseconds(3.0)]
    times_s = np.array([seconds(state.stamp_ns - int(drive.stamps[0])) for state in states])
    sigmas = np.sqrt([np.diag(state.twist_covariance) for state in states])
    return times_s, np.array([state.twist for state in states]), sigmas, np.stack([speed, turn], axis=1)


def at(true, times_s):
    """The true twists at times, (n, 2)."""
    return np.stack([np.interp(times_s, np.arange(len(true)) / RATE_HZ, column) for column in true.T], axis=1)


SLIPS = ((15.0, 16.0), (27.0, 28.0))


@pytest.mark.long
@pytest.mark.parametrize(("name", "slips"), [("stop_and_go", SLIPS), ("square", ()), ("loops", ())])
def test_with_late_images_the_twist_does_not_lag_and_is_as_certain_as_it_says(name, slips):
    times_s, twists, sigmas, true = driven(name, slips)
    assert (np.mean(np.abs(twists - at(true, times_s)) < 2.0 * sigmas, axis=0) > 0.95).all()
    lags_s = np.arange(-0.03, 0.06, 0.001)
    errors = np.array([np.square(twists - at(true, times_s - lag_s)).mean(axis=0) for lag_s in lags_s])
    assert (lags_s[np.argmin(errors, axis=0)] <= 0.010).all()
