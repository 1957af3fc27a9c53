# SPDX-License-Identifier: BSD-3-Clause
"""The rule by which images are left out, on motions along one line and turns, whose flow is known exactly."""

import numpy as np
import pytest

from ceiling_dso_ros.dso import PinholeCamera
from ceiling_dso_ros.dso.durations import nanoseconds, seconds
from ceiling_dso_ros.dso.tracking.track_history import ExpectedMotion
from ceiling_dso_ros.playback.frame_regulation import (
    GROWN,
    LARGEST_ACCELERATION_RAD_S2,
    LONGEST_S,
    SETTLING_S,
    FrameRegulation,
    RateReason,
)

CAMERA = PinholeCamera(430.0, 430.0, 424.0, 240.0, 848, 480)
CEILING_M = 4.0
POINT_RAD = 0.65  # of the points from the axis: what a turn moves them by
START_NS = 1_732_800_000_123_456_789
HZ = 30.0


class Drive:
    """A camera under a ceiling, with images at HZ.

    Args:
        way_m, yaw_rad: functions of the time in seconds.
        wheels: they predict the motion as it is; else it goes on as between the last two used images.
    """

    def __init__(self, way_m, yaw_rad=lambda _: 0.0, wheels=True):
        self.regulation = FrameRegulation(CAMERA)
        self._motion, self._wheels = (way_m, yaw_rad), wheels
        self.used_s, self.reasons, self.flows_px = [], [], []

    def drive(self, duration_s, rmse=lambda _: 4.0, begin_s=0.0):
        """Drive for a time; rmse of each image, None where it has no pose."""
        for number in range(round(begin_s * HZ), round((begin_s + duration_s) * HZ)):
            now_s = number / HZ
            stamp_ns = START_NS + nanoseconds(now_s)
            left_out = self.regulation.leaves_out(stamp_ns, self._expected(now_s))
            self.reasons.append(self.regulation.reason)
            assert left_out == (self.regulation.reason is RateReason.LEFT_OUT)
            if left_out:
                continue
            if self.used_s:
                self.flows_px.append(self._flow_px(*self._moved(self.used_s[-1], now_s)))
            self.used_s.append(now_s)
            self.regulation.use(stamp_ns, rmse(now_s))
        return self

    def _moved(self, start_s, end_s):
        return [value(end_s) - value(start_s) for value in self._motion]

    def _flow_px(self, way_m, yaw_rad):
        return CAMERA.fx * float(np.hypot(way_m / CEILING_M, POINT_RAD * yaw_rad))

    def _expected(self, now_s):
        if len(self.used_s) < 2:
            return None
        last_s, before_s = self.used_s[-1], self.used_s[-2]
        of_wheels = self._moved(last_s, now_s)
        own = np.multiply(self._moved(before_s, last_s), (now_s - last_s) / (last_s - before_s))
        told = [own, of_wheels] if self._wheels else [own]
        return ExpectedMotion(
            max(self._flow_px(*motion) for motion in told), max(abs(motion[1]) for motion in told), self._wheels
        )

    def rate_hz(self, start_s, end_s):
        return sum(start_s <= used_s < end_s for used_s in self.used_s) / (end_s - start_s)

    def reasons_within(self, start_s, end_s):
        return set(self.reasons[round(start_s * HZ) : round(end_s * HZ)])


def stands(_):
    return 0.0


def test_a_robot_that_stands_needs_a_tenth_of_the_images_at_most():
    run = Drive(stands).drive(20.0)
    assert run.rate_hz(0.0, SETTLING_S) == HZ
    assert run.rate_hz(SETTLING_S + LONGEST_S, 20.0) <= HZ / 10.0
    assert np.diff(run.used_s).max() <= LONGEST_S + 1e-6
    assert run.reasons_within(3.0, 20.0) == {RateReason.LEFT_OUT, RateReason.DUE}


@pytest.mark.parametrize("speed_m_s", [0.2, 0.6, 1.2])
def test_straight_ways_need_less_than_half_and_a_bounded_flow(speed_m_s):
    run = Drive(lambda t: speed_m_s * t).drive(10.0)
    assert run.rate_hz(3.0, 10.0) < HZ / 2.0
    per_image_px = CAMERA.fx * speed_m_s / CEILING_M / HZ
    assert max(run.flows_px) <= 0.009 * (848 + 480) + per_image_px + 1e-6
    assert np.diff(run.used_s).max() <= LONGEST_S + 1e-6


def test_a_fast_drive_and_a_fast_turn_use_every_image():
    assert Drive(lambda t: 5.0 * t).drive(5.0).rate_hz(0.0, 5.0) == HZ
    turn = Drive(stands, lambda t: 1.0 * t).drive(5.0)
    assert turn.rate_hz(0.0, 5.0) == HZ
    assert turn.reasons_within(3.0, 5.0) == {RateReason.TURNING}


@pytest.mark.parametrize("begin_s", 5.0 + np.arange(16) / HZ)
def test_wheels_tell_of_a_start_at_once(begin_s):
    """Of the strongest: the first image that is used then has moved hardly further than those of a steady drive."""
    run = Drive(lambda t: 1.0 * min(max(t - begin_s, 0.0), 1.0) ** 2).drive(6.0)  # at 2 m/s in the end
    assert max(run.flows_px) < 0.009 * (848 + 480) + CAMERA.fx * 2.0 / CEILING_M / HZ
    turn = Drive(stands, lambda t: 2.0 * min(max(t - begin_s, 0.0), 0.25) ** 2 + max(t - begin_s - 0.25, 0.0)).drive(
        8.0
    )
    assert turn.rate_hz(begin_s + 0.3, 8.0) == pytest.approx(HZ, rel=0.02)
    assert max(turn.flows_px) < 0.009 * (848 + 480) + CAMERA.fx * POINT_RAD / HZ


@pytest.mark.parametrize("begin_s", 5.0 + np.arange(16) / HZ)
def test_without_wheels_the_largest_acceleration_bounds_the_longest_gap(begin_s):
    """Nothing tells of a start but the next image: so it comes before a robot could have gone far."""
    run = Drive(lambda t: 0.5 * LARGEST_ACCELERATION_RAD_S2 * CEILING_M * max(t - begin_s, 0.0) ** 2, wheels=False)
    run.drive(5.9)
    assert run.rate_hz(SETTLING_S + LONGEST_S, 5.0) < HZ / 2.0
    accelerated_within_an_image_px = CAMERA.fx * LARGEST_ACCELERATION_RAD_S2 * (0.15 / HZ)
    assert max(run.flows_px) < 0.009 * (848 + 480) + 2.0 * accelerated_within_an_image_px + CAMERA.fx * 2.5 / HZ


def test_every_image_is_used_after_one_without_a_pose_and_when_the_error_grows():
    run = Drive(stands).drive(5.0)
    run.drive(1.0, rmse=lambda _: None, begin_s=5.0)
    run.drive(6.0, begin_s=6.0)
    missed_s = next(used_s for used_s in run.used_s if used_s >= 5.0)
    last_missed_s = max(used_s for used_s in run.used_s if used_s < 6.0)
    assert run.rate_hz(missed_s, last_missed_s + SETTLING_S) == pytest.approx(HZ, rel=0.02)
    assert run.rate_hz(last_missed_s + SETTLING_S + LONGEST_S, 12.0) <= HZ / 10.0

    run.drive(0.7, rmse=lambda _: 1.5 * GROWN * 4.0, begin_s=12.0)
    assert RateReason.ERROR in run.reasons_within(12.0, 12.7)
    run.drive(5.0, rmse=lambda _: 4.0, begin_s=12.7)
    assert run.reasons_within(15.0, 17.7) == {RateReason.LEFT_OUT, RateReason.DUE}


def test_nothing_is_left_out_where_nothing_is_known():
    regulation = FrameRegulation(CAMERA)
    for number in range(90):
        stamp_ns = START_NS + nanoseconds(number / HZ)
        assert not regulation.leaves_out(stamp_ns, None)
        regulation.use(stamp_ns, None)
    assert regulation.reason is RateReason.STARTING


def test_an_image_out_of_order_is_not_left_out():
    """Who uses images judges their order."""
    run = Drive(stands).drive(5.0)
    still = ExpectedMotion(0.0, 0.0, True)
    last_ns = START_NS + nanoseconds(run.used_s[-1])
    assert run.regulation.leaves_out(last_ns + 1, still)
    assert not run.regulation.leaves_out(last_ns, still)
    assert not run.regulation.leaves_out(last_ns - 10**9, still)


def test_the_same_stamps_and_motions_give_the_same_images():
    first, second = (Drive(lambda t: np.sin(t), lambda t: 0.3 * t).drive(20.0) for _ in range(2))
    assert first.used_s == second.used_s
    assert first.reasons == second.reasons


def test_numbers_are_counted_and_the_rate_is_that_of_late():
    run = Drive(stands).drive(10.0)
    summary = run.regulation.summary()
    assert summary["used"] == len(run.used_s) == sum(summary["reasons"].values())
    assert summary["used"] + summary["left_out"] == 300
    assert summary["reasons"]["starting"] == round(SETTLING_S * HZ)
    now_ns = START_NS + nanoseconds(10.0)
    assert run.regulation.rate_hz(now_ns) == pytest.approx(run.rate_hz(8.0, 10.0), abs=0.6)
    assert run.regulation.rate_hz(now_ns + 10**10) == 0.0
    run.regulation.restart()
    assert run.regulation.summary() == summary
    assert not run.regulation.leaves_out(now_ns, ExpectedMotion(0.0, 0.0, True))
    assert seconds(now_ns - START_NS) == 10.0
