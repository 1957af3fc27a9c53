# SPDX-License-Identifier: BSD-3-Clause
"""Sensors that are missing, wrong or late: what the fusion reports, and what it makes of the others."""

import dataclasses

import numpy as np
import pytest

from ceiling_dso_ros.dso import OdometryStatus, TrackingState
from ceiling_dso_ros.dso.durations import nanoseconds, seconds
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.estimator import FusionEstimator
from ceiling_dso_ros.fusion.state import FusionState

pytestmark = pytest.mark.long(minutes=4)


def test_silent_wheels_are_reported_and_the_camera_carries_the_pose(simulate, truth, fuse):
    drive = simulate("loops", 20.0, 1, truth())
    begin = drive.stamps[0]
    silent = [sample for sample in drive.ticks if not 10.0 < seconds(sample[0] - begin) < 13.0]
    estimator, outputs = FusionEstimator(drive.robot), []
    for stamp_ns, is_camera, data in dataclasses.replace(drive, ticks=silent).events():
        if is_camera:
            outputs += [estimator.add_keyframes(data), estimator.add_frame(data)]
        else:
            outputs.append(estimator.add_wheel_ticks(stamp_ns, *data))
    outputs = [state for state in outputs if state is not None]
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
    estimator, outputs = FusionEstimator(drive.robot), []
    for stamp_ns, is_camera, data in dataclasses.replace(drive, ticks=ticks).events():
        if is_camera:
            outputs += [estimator.add_keyframes(data), estimator.add_frame(data)]
        else:
            outputs.append(estimator.add_wheel_ticks(stamp_ns, *data))
    outputs = [state for state in outputs if state is not None and state.stamp_ns > back_ns - nanoseconds(1.0)]
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


def frozen(drive, after_s, keyframe_every=0):
    """From some time on the camera shows the same picture, with noise; returns when, nanoseconds, and its images.

    Args:
        keyframe_every: images to the next keyframe, as when the light changes; 0 for none.
    """
    begin_ns, rng = int(drive.stamps[0]) + nanoseconds(after_s), np.random.default_rng(0)
    seen = [status for status in drive.statuses if status.stamp_ns < begin_ns]
    last = next(status for status in reversed(seen) if status.T_keyframe_camera is not None)
    window = next(status.keyframes for status in reversed(seen) if status.keyframes)
    T_world_keyframe = next(each.T_world_camera for each in window if each.keyframe_id == last.keyframe_id)
    T_world_camera = T_world_keyframe @ last.T_keyframe_camera
    for number, status in enumerate(drive.statuses[len(seen) :], start=1):
        is_keyframe, T_shaken = keyframe_every > 0 and number % keyframe_every == 0, T_world_camera.copy()
        T_shaken[:3, 3] += 5e-5 * rng.normal(size=3)
        if is_keyframe:
            newest = dataclasses.replace(
                window[-1], keyframe_id=window[-1].keyframe_id + 1, stamp_ns=status.stamp_ns, T_world_camera=T_shaken
            )
            window = (*window[-6:], newest)
        T_keyframe_camera = np.linalg.inv(window[-1].T_world_camera) @ T_shaken
        seen.append(
            dataclasses.replace(
                last,
                stamp_ns=status.stamp_ns,
                keyframe_id=window[-1].keyframe_id,
                T_keyframe_camera=T_keyframe_camera,
                is_keyframe=is_keyframe,
                keyframes=window if is_keyframe else (),
            )
        )
    return begin_ns, dataclasses.replace(drive, statuses=seen)


@pytest.mark.parametrize(
    ("sequence", "keyframe_every"), [("loops", 0), ("straight", 0), ("loops", 5), ("straight", 40)]
)
def test_a_camera_that_shows_the_same_picture_does_not_stop_the_pose(simulate, truth, fuse, sequence, keyframe_every):
    """With noise it cannot be told from a robot that stands with turning wheels, but not for long.

    Also if it makes keyframes, as when the robot carries what it sees, and drives from lamp to lamp.
    """
    begin_ns, drive = frozen(simulate(sequence, 30.0, 2, truth()), 15.0, keyframe_every)
    fused = fuse(drive)
    later = [state for state in fused.states if state.stamp_ns > begin_ns + nanoseconds(0.5)]
    assert all(state.state is FusionState.DEGRADED for state in later)
    first = next(state for state in fused.states if state.stamp_ns >= begin_ns)
    moved = planar.between(first.pose, later[-1].pose)
    by_wheels = dict(zip((state.stamp_ns for state in fused.states), fused.wheel_poses))
    rolled = planar.between(by_wheels[first.stamp_ns], by_wheels[later[-1].stamp_ns])
    true = planar.between(drive.pose_at(first.stamp_ns), drive.pose_at(later[-1].stamp_ns))
    assert np.hypot(*rolled[:2]) > 1.0
    ours, theirs = (np.hypot(*planar.between(true, motion)[:2]) for motion in (moved, rolled))
    assert ours < theirs + 0.05


def test_a_robot_that_stands_with_turning_wheels_slips_until_the_camera_is_doubted(simulate, truth, fuse):
    begin_ns, drive = frozen(simulate("straight", 20.0, 2, truth()), 10.0)
    fused = fuse(drive)
    at_s = (begin_ns - int(drive.stamps[0])) * 1e-9
    assert "wheels: slip" in fused.reasons(at_s + 0.5, at_s + 1.8)
    assert fused.reasons(at_s + 2.5, at_s + 9.0) >= {
        "camera: not used, it has shown a robot that stands while the wheels turned"
    }
    still = [state for state in fused.states if 0.5 < (state.stamp_ns - begin_ns) * 1e-9 < 1.8]
    assert np.hypot(*planar.between(still[0].pose, still[-1].pose)[:2]) < 0.1


def test_a_brief_time_without_a_pose_is_no_reason(loops, fuse):
    """One flash; a longer time is one."""
    hit = next(k for k, s in enumerate(loops.statuses) if s.stamp_ns > loops.stamps[0] + nanoseconds(15.0))
    for images, expected in ((1, set()), (15, {"camera: retrying (flash)"})):
        statuses = list(loops.statuses)
        for k in range(hit, hit + images):
            statuses[k] = OdometryStatus(statuses[k].stamp_ns, TrackingState.RETRYING, 0, message="flash")
        reasons = fuse(dataclasses.replace(loops, statuses=statuses)).reasons(15.0, 15.0 + images / 30.0)
        assert {reason for reason in reasons if "retrying" in reason} == expected


def test_a_mount_that_is_known_late_changes_neither_pose_nor_covariance(loops, fuse):
    late_ns, estimator, states = loops.stamps[0] + nanoseconds(10.0), FusionEstimator(without_mount(loops.robot)), []
    mounted = False
    for stamp_ns, is_camera, data in loops.events():
        if not mounted and stamp_ns > late_ns:
            estimator.mount_camera(loops.robot.T_base_camera)
            mounted = True
        if not is_camera:
            states.append(estimator.add_wheel_ticks(stamp_ns, *data))
        elif mounted:
            estimator.add_keyframes(data)
            estimator.add_frame(data)
    states = [state for state in states if state is not None]
    assert len(states) == len(loops.ticks) - 1
    k = next(k for k, state in enumerate(states) if state.stamp_ns > late_ns)
    sigmas = [np.sqrt(np.trace(state.covariance[:2, :2])) for state in states]
    assert sigmas[k + 5] > 0.9 * sigmas[k - 5] > 0.0
    jumps = [np.hypot(*planar.between(a.pose, b.pose)[:2]) for a, b in zip(states, states[1:])]
    assert max(jumps) < 0.05
    assert states[-1].state is FusionState.CONVERGED


def without_mount(robot):
    return dataclasses.replace(robot, T_base_camera=np.eye(4))


def test_a_silent_camera_is_reported(loops, fuse):
    begin = loops.stamps[0]
    quiet = dataclasses.replace(
        loops, statuses=[s for s in loops.statuses if not 10.0 < seconds(s.stamp_ns - begin) < 13.0]
    )
    fused = fuse(quiet)
    assert any(reason.startswith("camera: silent") for reason in fused.reasons(11.5, 12.9))
    assert fused.reasons(14.5, 25.0) == set()


def test_a_covered_lens_is_reported_and_the_wheels_go_on(simulate, truth, fuse):
    clear = truth(ratio=0.01, base=0.01)
    fused = fuse(simulate("loops", 30.0, 5, dataclasses.replace(clear, losses=((12.0, 17.0),))))
    assert fused.reasons(12.2, 16.9) == {"camera: lost (covered)"}
    assert "scale: of segment 1 not known yet" in fused.reasons(17.0, 19.0)
    assert fused.reasons(21.0, 30.0) == set()
    assert fused.largest_jump() < 0.02
    drift = np.hypot(*drift_of_wheels(fused, 12.0, 17.0)[:2])
    assert np.hypot(*(fused.poses[-1] - fused.truth(fused.stamps[-1:])[0])[:2]) < drift + 0.02 + yaw_lever(fused, 17.0)


def turning(drive, segment, rate_rad_s):
    """A segment whose map is wrong: it turns about the optical axis while the robot drives."""
    seen = [status for status in drive.statuses if status.segment == segment and status.keyframes]
    begin_ns = seen[0].stamp_ns
    stamps_ns = {keyframe.keyframe_id: keyframe.stamp_ns for status in seen for keyframe in status.keyframes}

    def turn(stamp_ns):
        T = np.eye(4)
        T[:2, :2] = planar.rotation(rate_rad_s * max(seconds(stamp_ns - begin_ns), 0.0))
        return T

    def turned(status):
        if status.segment != segment or status.T_keyframe_camera is None:
            return status
        T = np.linalg.inv(turn(stamps_ns[status.keyframe_id])) @ status.T_keyframe_camera @ turn(status.stamp_ns)
        keyframes = tuple(
            dataclasses.replace(keyframe, T_world_camera=keyframe.T_world_camera @ turn(keyframe.stamp_ns))
            for keyframe in status.keyframes
        )
        return dataclasses.replace(status, T_keyframe_camera=T, keyframes=keyframes)

    return dataclasses.replace(drive, statuses=[turned(status) for status in drive.statuses])


@pytest.mark.parametrize("rate_rad_s", [-0.3, 1.0])
def test_a_new_map_that_contradicts_the_wheels_is_not_used(simulate, truth, fuse, rate_rad_s):
    """As one that was made of a few lamps in the dark. It is not the wheels that slip."""
    drive = simulate("loops", 24.0, 5, truth(losses=((14.0, 15.0),)))
    fused = fuse(turning(drive, 1, rate_rad_s))
    off = planar.between(fused.truth(fused.stamps[-1:])[0], fused.poses[-1])
    assert abs(off[2]) < 0.04  # what the wheels' noise makes of ten seconds
    assert np.hypot(*off[:2]) < 0.15
    assert fused.estimator.slips == []
    assert "scale: of segment 1 not known yet" in fused.reasons(22.0, 24.0)


@pytest.mark.parametrize("blind_s", [5.0, 14.0])  # the latter longer than single steps are remembered
def test_what_the_wheels_did_of_late_bridges_a_covered_lens(simulate, truth, fuse, blind_s):
    """Their wrong constants turn the wheels by 0.02 rad a metre; as seen beside the camera before, by far less."""
    end_s = 15.0 + blind_s
    true = truth(ratio=0.01, base=0.01, wheel_noise=5e-4, losses=((15.0, end_s),))
    fused = fuse(simulate("loops", end_s + 4.0, 5, true))
    blind = slice(*np.searchsorted(fused.times_s, [15.0, end_s]))
    yaws = np.unwrap(fused.truth(fused.stamps[blind])[:, 2])
    wheels, published = (np.unwrap(poses[blind, 2]) - yaws for poses in (fused.wheel_poses, fused.poses))
    assert abs(published[-1] - published[0]) < 0.6 * abs(wheels[-1] - wheels[0])
    assert fused.largest_jump() < 0.01  # the graph bridges as the live estimate did


def drift_of_wheels(fused, start_s, end_s):
    """Error of the wheels' motion over an interval."""
    first, last = np.searchsorted(fused.times_s, [start_s, end_s])
    true = fused.truth(fused.stamps[[first, last]])
    return planar.between(planar.between(*true), planar.between(fused.wheel_poses[first], fused.wheel_poses[last]))


def yaw_lever(fused, since_s):
    """How far the yaw that the wheels lost while blind moves the end of the drive."""
    true = fused.truth([fused.drive.stamps[0] + nanoseconds(since_s), fused.stamps[-1]])
    return abs(drift_of_wheels(fused, 12.0, 17.0)[2]) * np.hypot(*(true[1] - true[0])[:2])


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


def test_a_motion_off_the_floor_is_not_used(loops, fuse, fused):
    def lifted(status):
        if not status.keyframes or status.keyframe_id != 50:
            return status
        keyframes = [dataclasses.replace(k, T_world_camera=k.T_world_camera.copy()) for k in status.keyframes]
        keyframes[-1].T_world_camera[2, 3] += 0.1
        return dataclasses.replace(status, keyframes=tuple(keyframes))

    spoilt = fuse(dataclasses.replace(loops, statuses=[lifted(status) for status in loops.statuses]))
    assert any("floor" in reason for state in spoilt.states for reason in state.reasons)
    np.testing.assert_allclose(spoilt.poses[-1], fused.poses[-1], atol=0.02)


def test_a_time_offset_of_the_camera_is_taken_into_account(simulate, truth, fuse):
    late = simulate("loops", 25.0, 8, truth(camera_delay_s=0.05))
    known = dataclasses.replace(late.robot, camera_time_offset_s=-0.05)
    right = fuse(dataclasses.replace(late, robot=known))
    wrong = fuse(late)
    assert right.ate(right.stamps, right.poses) < 0.5 * wrong.ate(wrong.stamps, wrong.poses)


def blurred(drive, sigma, told):
    """A drive in which a second of images errs by sigma, units, along the camera's axes, and says so or not."""
    rng, begin_ns = np.random.default_rng(4), int(drive.stamps[0]) + nanoseconds(12.0)
    covariance = np.diag([sigma, sigma, sigma, 1e-9, 1e-9, 1e-9]) ** 2
    statuses = []
    for status in drive.statuses:
        if begin_ns <= status.stamp_ns < begin_ns + nanoseconds(3.0) and status.T_keyframe_camera is not None:
            T = status.T_keyframe_camera.copy()
            T[:3, 3] += T[:3, :3] @ (sigma * rng.normal(size=3))
            status = dataclasses.replace(status, T_keyframe_camera=T, relative_covariance=covariance if told else None)
        statuses.append(status)
    return dataclasses.replace(drive, statuses=statuses)


def test_images_that_say_how_badly_they_see_count_for_less(loops, fuse):
    def rms_m(told):
        outputs = fuse(blurred(loops, 2e-3, told)).states
        begin_ns = int(loops.stamps[0]) + nanoseconds(12.0)
        errors = [
            np.hypot(*(state.pose - loops.pose_at(state.stamp_ns))[:2])
            for state in outputs
            if begin_ns <= state.stamp_ns < begin_ns + nanoseconds(3.0)
        ]
        return np.sqrt(np.mean(np.square(errors)))

    assert rms_m(told=True) < 0.5 * rms_m(told=False)


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
