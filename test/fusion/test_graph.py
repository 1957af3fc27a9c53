# SPDX-License-Identifier: BSD-3-Clause
from dataclasses import replace

import numpy as np
import pytest
from winding_chain import BASE, NOISE, SCALE, chain, config

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.config import FusionConfig, GraphConfig, ScaleConfig, WheelConfig
from ceiling_dso_ros.fusion.graph import WindowGraph
from ceiling_dso_ros.fusion.wheel_motion import WheelMotion, WheelStep


def run(graph, intervals):
    for interval in intervals:
        graph.add(interval)
        estimate = graph.optimize()
    return estimate


def test_perfect_data_give_the_truth_and_the_scale():
    intervals, poses = chain(60)
    estimate = run(WindowGraph(config(), NOISE), intervals)
    np.testing.assert_allclose(estimate.pose[:2], poses[-1][:2], atol=1e-3)
    assert np.exp(estimate.log_scale) == pytest.approx(SCALE, rel=1e-3)


def test_the_camera_holds_the_heading_where_the_wheels_turn_wrong():
    intervals, poses = chain(60, wheel_turn=0.02)
    estimate = run(WindowGraph(config(), NOISE), intervals)
    assert abs(planar.wrap(estimate.pose[2] - poses[-1][2])) < 0.02 * 60 * 0.15 / 20


def test_a_ceiling_height_is_where_the_scale_begins():
    intervals, _ = chain(1)
    height = config(scale=ScaleConfig(ceiling_height_m=7.0, height_sigma=0.2))
    estimate = run(WindowGraph(height, NOISE), intervals)
    assert np.exp(estimate.log_scale) == pytest.approx(7.0)
    assert estimate.scale_sigma == pytest.approx(0.2, rel=1e-3)


def test_scale_of_a_new_segment_is_estimated_anew_and_the_pose_is_kept():
    intervals, poses = chain(60, segment_at=30)
    graph = WindowGraph(config(), NOISE)
    before = run(graph, intervals[:29])
    first = run(graph, intervals[29:30])
    assert np.exp(before.log_scale) == pytest.approx(SCALE, rel=1e-3)
    assert first.scale_sigma > 0.5
    np.testing.assert_allclose(first.pose, poses[30], atol=5e-3)
    after = run(graph, intervals[30:])
    assert np.exp(after.log_scale) == pytest.approx(1.4 * SCALE, rel=1e-3)


@pytest.mark.parametrize("height_m", [None, 7.0])
def test_a_new_segment_begins_with_what_is_known_of_the_ceiling(height_m):
    """Rather than with the height that was given: that may be of another place."""
    intervals, _ = chain(31, segment_at=30)
    intervals[29] = replace(intervals[29], log_scale=np.log(1.4 * SCALE) + 0.05)
    graph = WindowGraph(config(scale=ScaleConfig(ceiling_height_m=height_m, height_sigma=0.2)), NOISE)
    first = run(graph, intervals[:30])
    assert first.log_scale == pytest.approx(intervals[29].log_scale, abs=0.05)
    assert first.scale_sigma < 0.21
    assert np.exp(run(graph, intervals[30:]).log_scale) == pytest.approx(1.4 * SCALE, rel=0.05)


def without_shift(interval):
    """Turned on the spot: the camera is above the turning centre and sees no motion that could tell the scale."""
    turned = replace(interval.visual, shift=np.zeros(2), lever_m=np.zeros(3))
    step = WheelStep((interval.end - 1) * 10**9, interval.end * 10**9, np.array([0.0, 0.0, interval.visual.yaw]))
    return replace(interval, visual=turned, wheels=NOISE.extend(WheelMotion.nothing((interval.end - 1) * 10**9), step))


@pytest.mark.parametrize("untold", [without_shift, lambda interval: replace(interval, visual=None)])
def test_a_new_segment_may_tell_nothing_of_its_scale_for_long(untold):
    """Its scales are held by a prior of sigma 1, and to each other ten thousand times more firmly."""
    intervals, _ = chain(60, segment_at=20)
    intervals[20:50] = [untold(interval) for interval in intervals[20:50]]
    graph = WindowGraph(config(), NOISE)
    run(graph, intervals[:20])
    for interval in intervals[20:50]:
        estimate = run(graph, [interval])
        assert graph.intervals[-1].visual is interval.visual
        assert estimate.scale_sigma == pytest.approx(1.0, abs=0.05)
        assert estimate.log_scale == pytest.approx(np.log(4.0), abs=0.05)
    after = run(graph, intervals[50:])
    assert np.exp(after.log_scale) == pytest.approx(1.4 * SCALE, rel=2e-3)
    assert after.scale_sigma < 0.01


def test_what_leaves_the_window_stays_as_a_prior():
    """On a linear problem nothing would be lost; here next to nothing is."""
    intervals, _ = chain(80, np.random.default_rng(1))
    short = run(WindowGraph(config(window=10), NOISE), intervals)
    whole = run(WindowGraph(config(window=100), NOISE), intervals)
    sigma = np.sqrt(np.diag(whole.covariance))
    assert (np.abs(planar.between(whole.pose, short.pose)) < 0.1 * sigma).all()
    np.testing.assert_allclose(np.sqrt(np.diag(short.covariance)), sigma, rtol=0.02)
    assert short.log_scale == pytest.approx(whole.log_scale, abs=0.1 * whole.scale_sigma)
    assert short.scale_sigma == pytest.approx(whole.scale_sigma, rel=0.02)


def test_revising_a_motion_replaces_it():
    intervals, poses = chain(12)
    graph = WindowGraph(config(), NOISE)
    spoilt = replace(intervals[8], visual=replace(intervals[8].visual, yaw=intervals[8].visual.yaw + 0.002))
    run(graph, [*intervals[:8], spoilt, *intervals[9:]])
    graph.revise(9, visual=intervals[8].visual)
    np.testing.assert_allclose(graph.optimize().pose, poses[-1], atol=1e-4)


def test_revising_what_has_left_the_window_changes_nothing():
    intervals, _ = chain(40)
    graph = WindowGraph(config(window=10), NOISE)
    before = run(graph, intervals)
    graph.revise(3, visual=None)
    np.testing.assert_allclose(graph.optimize().pose, before.pose, atol=1e-6)


def test_slipping_wheels_have_no_say():
    intervals, poses = chain(40)
    slip = WheelMotion.nothing(29 * 10**9)
    slip = NOISE.extend(slip, WheelStep(29 * 10**9, 30 * 10**9, np.array([0.25, 0.0, 0.5])))
    intervals[29] = replace(intervals[29], wheels=slip, wheels_slip=True)
    estimate = run(WindowGraph(config(), NOISE), intervals)
    np.testing.assert_allclose(estimate.pose, poses[-1], atol=3e-3)


@pytest.mark.parametrize("keep", [True, False])
def test_history_is_kept_only_when_asked_for(keep):
    intervals, _ = chain(30)
    graph = WindowGraph(config(window=10), NOISE, keep_history=keep)
    run(graph, intervals)
    assert len(graph.intervals) == 10
    assert (graph.history is None) if not keep else [int(motion["end"]) for motion in graph.history] == [*range(1, 21)]


def test_the_wheels_constants_and_the_cameras_yaw_can_be_estimated():
    ratio_turn = 0.01 / BASE  # 1 % of ratio
    intervals, _ = chain(120, wheel_turn=-ratio_turn)
    estimating = FusionConfig(graph=GraphConfig(estimate_wheels=True))
    estimate = run(WindowGraph(estimating, NOISE), intervals)
    assert estimate.constants[0] == pytest.approx(0.01, abs=0.001)
    sigma = np.sqrt(np.diag(estimate.constants_covariance))
    assert sigma[0] < 0.5 * WheelConfig().ratio_sigma


def test_a_visual_motion_without_a_solution_is_left_out():
    intervals, poses = chain(6)
    wild = replace(intervals[-1].visual, shift=np.array([1e160, 0.0]))
    graph = WindowGraph(config(), NOISE)
    estimate = run(graph, [*intervals[:-1], replace(intervals[-1], visual=wild)])
    assert graph.intervals[-1].visual is None
    np.testing.assert_allclose(estimate.pose, poses[-1], atol=0.01)
    assert np.isfinite(estimate.covariance).all()
    assert estimate.log_scale == pytest.approx(np.log(SCALE), abs=0.05)


def refuse(*_):
    raise RuntimeError


@pytest.mark.parametrize(("filled", "part"), [(3, "_builder.factors"), (10, "_builder.factors"), (10, "_motion")])
def test_what_cannot_be_added_changes_nothing(filled, part, monkeypatch):
    """Whether the window is not full yet, or something has to leave it."""
    intervals, _ = chain(filled + 3)
    graph, untouched = (WindowGraph(config(window=10), NOISE, keep_history=True) for _ in range(2))
    before = run(graph, intervals[:filled])
    holder = graph._builder if "." in part else graph
    with monkeypatch.context() as broken:
        broken.setattr(holder, part.rpartition(".")[2], refuse)
        with pytest.raises(RuntimeError):
            graph.add(intervals[filled])
    assert (graph.newest, len(graph.intervals), len(graph.history)) == (filled, filled, 0)
    np.testing.assert_allclose(graph.optimize().pose, before.pose, atol=1e-6)
    run(untouched, intervals[:filled])
    np.testing.assert_allclose(run(graph, intervals[filled:]).pose, run(untouched, intervals[filled:]).pose, atol=1e-6)
