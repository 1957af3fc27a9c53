# SPDX-License-Identifier: BSD-3-Clause
"""Wheels that are missing, slip, are stuck or count anew, and jumps of the visual scale, which look like slips."""

import dataclasses

import numpy as np
import pytest

from ceiling_dso_ros.dso.durations import nanoseconds, seconds
from ceiling_dso_ros.dso.status import OdometryStatus, TrackingState
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.estimator import FusionEstimator
from ceiling_dso_ros.fusion.state import FusionState

pytestmark = pytest.mark.long(minutes=2)


def played(drive, ticks):
    """The outputs of a drive with other wheel samples."""
    estimator, outputs = FusionEstimator(drive.robot), []
    for stamp_ns, is_camera, data in dataclasses.replace(drive, ticks=ticks).events():
        if is_camera:
            outputs += [estimator.add_keyframes(data), estimator.add_frame(data)]
        else:
            outputs.append(estimator.add_wheel_ticks(stamp_ns, *data))
    return [state for state in outputs if state is not None]


def test_silent_wheels_are_reported_and_the_camera_carries_the_pose(simulate, truth, fuse):
    drive = simulate("loops", 20.0, 1, truth())
    begin = drive.stamps[0]
    silent = [sample for sample in drive.ticks if not 10.0 < seconds(sample[0] - begin) < 13.0]
    outputs = played(drive, silent)
    blind = [state for state in outputs if 11.0 < seconds(state.stamp_ns - begin) < 12.9]
    assert len(blind) > 40
    for state in blind:
        assert state.state is FusionState.DEGRADED
        assert any(reason.startswith("wheels: silent") for reason in state.reasons)
        assert np.hypot(*(state.pose - drive.pose_at(state.stamp_ns))[:2]) < 0.1
    assert outputs[-1].state is FusionState.CONVERGED
    assert np.hypot(*(outputs[-1].pose - drive.pose_at(outputs[-1].stamp_ns))[:2]) < 0.1
    assert (np.diff([state.stamp_ns for state in outputs]) > 0).all()


def test_wheels_that_count_anew_after_a_silence_do_not_stop_the_pose(simulate, truth):
    """As when their node was restarted: the first motion is not known, but the camera saw how fast the robot is."""
    drive = simulate("loops", 20.0, 1, truth())
    back_ns = drive.stamps[0] + nanoseconds(13.0)
    zero = np.array(next(sample[1:] for sample in drive.ticks if sample[0] >= back_ns))
    ticks = [sample for sample in drive.ticks if sample[0] < back_ns - nanoseconds(2.0)]
    ticks += [(sample[0], *(np.array(sample[1:]) - zero)) for sample in drive.ticks if sample[0] >= back_ns]
    outputs = [state for state in played(drive, ticks) if state.stamp_ns > back_ns - nanoseconds(1.0)]
    assert any("wheels: counters restarted" in state.reasons for state in outputs)
    for before, after in zip(outputs, outputs[1:]):
        true = planar.between(drive.pose_at(before.stamp_ns), drive.pose_at(after.stamp_ns))
        beyond = planar.between(true, planar.between(before.pose, after.pose))
        assert np.hypot(*beyond[:2]) < 0.01
        assert abs(beyond[2]) < 0.01


def test_images_without_wheels_do_not_pile_up(loops):
    """One wheel sample, then none: nothing tells when the camera's data could be used."""
    estimator = FusionEstimator(loops.robot)
    stamp_ns, *first = loops.ticks[0]
    estimator.add_wheel_ticks(stamp_ns, *first)
    most, begin_ns = 0, loops.statuses[0].stamp_ns
    for status in loops.statuses:
        estimator.add_keyframes(status)
        estimator.add_frame(status)
        most = max(most, len(estimator._waiting))
    assert seconds(loops.statuses[-1].stamp_ns - begin_ns) > 20.0
    assert 300 <= most <= 400
    waiting = [seconds(entry[0] - estimator._waiting[-1][0]) for entry in estimator._waiting]
    assert min(waiting) >= -10.0
    state = [estimator.add_wheel_ticks(*sample[:1], *sample[1:]) for sample in loops.ticks[-100:]][-1]
    assert estimator._waiting == []
    assert np.isfinite(state.pose).all()


def test_slip_is_reported_and_does_little_harm(simulate, truth, fuse):
    slips = ((8.0, 8.5), (15.0, 15.5))
    fused = fuse(simulate("loops", 22.0, 6, truth(slips=slips)))
    begin = fused.drive.stamps[0]
    within = [(seconds(r.start_ns - begin), seconds(r.end_ns - begin)) for r in fused.estimator.slips]
    assert [(round(start_s), round(end_s)) for start_s, end_s in within] == [(8, 9), (15, 16)]
    assert "wheels: slip" in fused.reasons(8.2, 8.9)
    assert fused.reasons(10.0, 14.8) == set()
    assert fused.largest_jump() < 0.1  # the wheels themselves jump until the first image contradicts them
    assert fused.ate(fused.stamps, fused.poses) < 0.03 * fused.ate(fused.stamps, fused.wheel_poses)


def test_a_jump_of_the_visual_scale_is_noticed_and_followed(simulate, truth, fuse):
    fused = fuse(simulate("loops", 30.0, 7, truth(scale_jumps=((12.0, 1.15),))))
    assert "scale: jumped" in fused.reasons(12.0, 15.0)
    assert abs(fused.scale_error()) < 0.01
    assert fused.estimator.slips == []
    assert fused.ate(fused.stamps, fused.poses) < 0.05


@pytest.mark.parametrize("factor", [0.9, 0.96, 1.05, 1.1, 1.3])
def test_both_wheels_that_slip_steadily_are_no_jump_of_the_scale(simulate, truth, fuse, factor):
    """The ceiling is as far away as before, in the odometry's units."""
    fused = fuse(simulate("loops", 30.0, 7, truth(slips=((12.0, 18.0),), slip_factor=factor, both_slip=True)))
    assert "scale: jumped" not in fused.reasons(0.0, 30.0)
    assert "wheels: slip" in fused.reasons(13.0, 18.0)
    assert abs(fused.scale_error()) < 0.01
    assert fused.ate(fused.stamps, fused.poses) < 0.03


@pytest.mark.parametrize(("losses", "begin_s", "end_s"), [(((8.0, 9.0),), 9.0, 11.0), ((), 0.5, 3.0)])
def test_wheels_that_are_stuck_are_not_believed_against_a_new_map(simulate, truth, fuse, losses, begin_s, end_s):
    """Until its scale is known, either may be wrong: the covariance must say so."""
    drive = simulate("loops", 26.0, 3, truth(losses=losses))
    begin_ns, end_ns = (int(drive.stamps[0]) + nanoseconds(at_s) for at_s in (begin_s, end_s))
    held = next(sample for sample in drive.ticks if sample[0] >= begin_ns)
    after = next(sample for sample in drive.ticks if sample[0] >= end_ns)
    missing = [after[side] - held[side] for side in (1, 2)]
    ticks = [
        sample
        if sample[0] < begin_ns
        else (sample[0], held[1], held[2])
        if sample[0] < end_ns
        else (sample[0], sample[1] - missing[0], sample[2] - missing[1])
        for sample in drive.ticks
    ]
    fused = fuse(dataclasses.replace(drive, ticks=ticks))
    wrong = []
    for state in fused.states:
        error = state.pose - drive.pose_at(state.stamp_ns)
        error[2] = planar.wrap(error[2])
        if state.state is FusionState.CONVERGED:
            wrong.append(float(np.sqrt(error @ np.linalg.solve(state.covariance, error))))
    assert max(wrong) < 5.0


def test_encoders_that_stick_and_catch_up_leave_the_pose_known(simulate, truth):
    """What the camera takes back is no blind way: the pose is right, and its covariance says so."""
    drive = simulate("loops", 30.0, 1, truth())
    begin, ticks, held = drive.stamps[0], [], None
    for stamp_ns, *counts in drive.ticks:
        time_s = seconds(stamp_ns - begin)
        if held is None or not (10.0 < time_s < 16.0 and (time_s - 10.0) % 0.5 < 0.25):
            held = counts
        ticks.append((stamp_ns, *held))
    last = played(drive, ticks)[-1]
    assert last.state is FusionState.CONVERGED
    error_m = np.hypot(*(last.pose - drive.pose_at(last.stamp_ns))[:2])
    sigmas = np.sqrt(np.diag(last.covariance))
    assert error_m < 0.1
    assert error_m < 4.0 * np.hypot(*sigmas[:2])
    assert np.hypot(*sigmas[:2]) < 0.3
    assert sigmas[2] < 0.1


@pytest.mark.parametrize("scale_known", [True, False])
def test_what_the_wheels_counted_while_nobody_saw_is_not_lost(simulate, truth, scale_known):
    """Their samples of two seconds are delayed, while the camera sees nothing, or its scale is not known yet."""
    drive = simulate("loops", 20.0, 1, truth())
    silent_s = (10.0, 12.0) if scale_known else (0.3, 2.3)
    silent_ns = [drive.stamps[0] + nanoseconds(each) for each in silent_s]
    estimator, outputs, kept = FusionEstimator(drive.robot), [], []
    for stamp_ns, is_camera, data in drive.events():
        in_silence = silent_ns[0] < stamp_ns < silent_ns[1]
        if is_camera:
            if in_silence and scale_known:
                data = OdometryStatus(data.stamp_ns, TrackingState.RETRYING, data.segment)
            outputs += [estimator.add_keyframes(data), estimator.add_frame(data)]
        elif in_silence:
            kept.append((stamp_ns, *data))
        else:
            for sample in [*kept, (stamp_ns, *data)]:
                outputs.append(estimator.add_wheel_ticks(*sample))
            kept = []
    outputs = [state for state in outputs if state is not None]
    assert (np.diff([state.stamp_ns for state in outputs]) > 0).all()
    held = [
        state for state in outputs if silent_ns[0] + nanoseconds(0.6) < state.stamp_ns < silent_ns[1] - nanoseconds(0.1)
    ]
    assert len(held) > 10
    for state in held:
        error = state.pose - drive.pose_at(state.stamp_ns)
        assert error @ np.linalg.solve(state.covariance, error) < 30.0
        assert any(reason.startswith("wheels: silent") for reason in state.reasons)
    error = outputs[-1].pose - drive.pose_at(outputs[-1].stamp_ns)
    assert np.hypot(*error[:2]) < 0.1
    for before, after in zip(outputs, outputs[1:]):  # what was missing comes as a correction, without a jump
        time_s = seconds(after.stamp_ns - before.stamp_ns)
        fastest_m_s = 1.5 + estimator.config.output.max_correction_m_s
        assert np.hypot(*planar.between(before.pose, after.pose)[:2]) < fastest_m_s * time_s + 0.01


@pytest.mark.parametrize("interval_s", [0.6, 1.0])
def test_wheels_that_count_slowly_are_not_silent(simulate, truth, interval_s):
    """Between two of their samples nothing is invented, and what they counted is not given up for it."""
    drive, slow = simulate("loops", 30.0, 1, truth()), []
    for sample in drive.ticks:
        if not slow or seconds(sample[0] - slow[-1][0]) >= interval_s:
            slow.append(sample)
    outputs = played(drive, slow)
    assert outputs[-1].state is FusionState.CONVERGED
    errors = np.array([state.pose - drive.pose_at(state.stamp_ns) for state in outputs])
    assert np.hypot(*errors[:, :2].T).max() < 0.15
