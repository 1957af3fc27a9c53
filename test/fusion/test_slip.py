# SPDX-License-Identifier: BSD-3-Clause
import math

import numpy as np
import pytest

from ceiling_dso_ros.fusion.config import FusionConfig, WheelConfig
from ceiling_dso_ros.fusion.graph import Interval
from ceiling_dso_ros.fusion.slip import LONGEST_SLIP_M, SlipMonitor
from ceiling_dso_ros.fusion.visual import VisualMotion
from ceiling_dso_ros.fusion.wheel_motion import WheelMotion, WheelNoise, WheelStep

NOISE = WheelNoise(WheelConfig(), 0.5, 1e-4)
SCALE, SIGMA = 4.0, 0.002
STEP_NS = 170_000_000


def interval(end, wheel=(0.15, 0.01), camera=(0.15, 0.01), depth=math.nan):
    """Wheels and camera as (forward m, turn rad)."""
    step = WheelStep((end - 1) * STEP_NS, end * STEP_NS, np.array([wheel[0], 0.0, wheel[1]]))
    visual = VisualMotion(np.array([camera[0] / SCALE, 0.0]), 0.0, camera[1], np.zeros(2), np.zeros(3))
    wheels = NOISE.extend(WheelMotion.nothing(step.start_ns), step)
    return Interval(end, step.end_ns, wheels, visual, continues=True, depth=depth)


def feed(monitor, intervals, scale_known=True):
    results = []
    for item in intervals:
        found = monitor.compare(item.wheels, item.visual, SCALE, SIGMA)
        results.append((monitor.slips(item, found, scale_known), monitor.steady_error()))
    return results


@pytest.fixture
def monitor():
    return SlipMonitor(FusionConfig(), NOISE)


def test_agreement_is_no_slip(monitor):
    assert feed(monitor, [interval(k) for k in range(1, 50)]) == [(False, None)] * 49
    assert monitor.reports == []


def test_a_wrong_turn_is_slip_even_without_scale(monitor):
    ((slips, _),) = feed(monitor, [interval(1, wheel=(0.15, 0.11))], scale_known=False)
    assert slips
    assert len(monitor.reports) == 1


def test_a_wrong_distance_is_slip_once_the_scale_is_known(monitor):
    spinning = interval(1, wheel=(0.3, 0.01))
    assert feed(monitor, [spinning], scale_known=False) == [(False, None)]
    assert feed(monitor, [spinning], scale_known=True) == [(True, None)]


def test_pushed_with_blocked_wheels_is_slip(monitor):
    assert feed(monitor, [interval(1, wheel=(0.0, 0.0))]) == [(True, None)]


def test_near_slips_are_one_report_and_far_ones_two(monitor):
    bad = (0.15, 0.2)
    feed(monitor, [interval(k, wheel=bad if k in (3, 4, 6, 30) else (0.15, 0.01)) for k in range(1, 40)])
    assert len(monitor.reports) == 2
    assert monitor.reports[0].start_ns == 2 * STEP_NS
    assert monitor.reports[0].end_ns == 6 * STEP_NS


def test_a_distance_that_stays_wrong_by_one_factor_is_a_jump_of_the_scale(monitor):
    before = [interval(k, depth=1.0) for k in range(1, 10)]
    results = feed(monitor, before + [interval(k, camera=(0.15 * 0.8, 0.01), depth=0.8) for k in range(10, 20)])
    jumps = [jump for _, jump in results if jump is not None]
    assert jumps[:1] == [(10, True, 0.0)]
    monitor.forget(9 * STEP_NS)
    assert all(report.end_ns <= 9 * STEP_NS for report in monitor.reports)


@pytest.mark.parametrize("share", [0.96, 1.05])
@pytest.mark.parametrize("knows_depth", [True, False])
@pytest.mark.parametrize("steps_before", [20, 200])
def test_a_small_error_that_no_single_step_shows_is_a_slip_until_it_lasts_for_too_long(
    monitor, share, knows_depth, steps_before
):
    """The depth of a roof changes by as much: it does not tell. What lasts longer than it was right before is right."""
    depths = np.exp(0.03 * np.random.default_rng(1).normal(size=400)) if knows_depth else np.full(400, math.nan)
    cameras = [(0.15 * (1.0 if k < steps_before else share), 0.01) for k in range(steps_before + 100)]
    results = feed(monitor, [interval(k, camera=cameras[k], depth=depths[k]) for k in range(1, len(cameras))])
    assert not any(slips for slips, _ in results)
    found = [(k, error) for k, (_, error) in enumerate(results, 1) if error is not None]
    last, jump = next((k, error) for k, error in found if error.of_scale)
    lasted_m = 0.15 * (last - steps_before)
    limit_m = min(LONGEST_SLIP_M, 0.15 * steps_before)
    assert found[0][0] < steps_before + 10
    assert limit_m < lasted_m < limit_m + 2.0
    assert jump.doubt_m > abs(1.0 / share - 1.0) * 0.15 * (last - steps_before) * 0.5


@pytest.mark.parametrize("share", [0.7, 0.8, 1.2, 1.3])
def test_the_depth_of_the_map_tells_a_jump_of_the_scale_from_wheels_that_slip_steadily(monitor, share):
    """In a jump the units of the way and of the depth change together."""
    rng = np.random.default_rng(0)
    before = [interval(k, depth=1.1 + 0.01 * rng.normal()) for k in range(1, 10)]
    for of_scale in (True, False):
        after = [
            interval(k, camera=(0.15 * share, 0.01), depth=(1.1 * share if of_scale else 1.1) + 0.01 * rng.normal())
            for k in range(10, 20)
        ]
        first = next(error for _, error in feed(monitor, before + after) if error is not None)
        assert first.of_scale == of_scale
        monitor = SlipMonitor(FusionConfig(), NOISE)


def test_a_short_spin_of_both_wheels_is_no_jump(monitor):
    results = feed(monitor, [interval(k, wheel=(0.3 if 10 <= k < 13 else 0.15, 0.01)) for k in range(1, 30)])
    assert [k for k, (slips, _) in enumerate(results, 1) if slips] == [10, 11, 12]
    assert all(jump is None for _, jump in results)


def test_of_many_slips_the_newest_are_kept(monitor, monkeypatch):
    monkeypatch.setattr("ceiling_dso_ros.fusion.slip.MOST_REPORTS", 5)
    for number in range(20):
        feed(monitor, [interval(10 * number + 1, wheel=(0.3, 0.1))])
    assert [report.start_ns for report in monitor.reports] == [10 * number * STEP_NS for number in range(15, 20)]
