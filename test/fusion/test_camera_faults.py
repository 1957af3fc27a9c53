# SPDX-License-Identifier: BSD-3-Clause
"""A camera that is missing, wrong or late: what the fusion reports, and what it makes of the wheels."""

import dataclasses
import re

import numpy as np
import pytest
from simulated_drive import RATE_HZ, Drive, encoder_ticks, record_camera, true_motion

from ceiling_dso_ros.dso import OdometryStatus, TrackingState
from ceiling_dso_ros.dso.durations import nanoseconds, seconds
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.backend import KeyframeBackend
from ceiling_dso_ros.fusion.ceiling_height import CeilingHeight
from ceiling_dso_ros.fusion.config import RobotModel
from ceiling_dso_ros.fusion.estimator import FusionEstimator
from ceiling_dso_ros.fusion.state import FusionState

pytestmark = pytest.mark.long(minutes=2)


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


def stopped_for_a_while(sequence, truth, begin_s, length_s, stands):
    """The camera shows one picture for a time, as the robot stands with turning wheels, or as its driver hangs."""
    poses, v, w = true_motion(sequence, 30.0)
    robot, rng = RobotModel(truth.T_base_camera, 0.485, (0.098, 0.098), 4096.0), np.random.default_rng(5)
    stamps = 1_000 * 10**9 + np.rint(np.arange(len(poses)) * (1e9 / RATE_HZ)).astype(np.int64)
    begin, length = int(begin_s * RATE_HZ), int(length_s * RATE_HZ)
    now = np.arange(len(poses))
    standing = np.where(now < begin, now, np.maximum(now - length, begin))
    frozen_now = np.where((now < begin) | (now >= begin + length), now, begin)
    true = poses[standing] if stands else poses
    rolled = v if not stands else np.where((now >= begin) & (now < begin + length), 0.8, v[standing % len(v)])[: len(v)]
    turned = w if not stands else np.where(now[: len(w)] < begin, w, w[standing[: len(w)] % len(w)])
    ticks = encoder_ticks(stamps, rolled, turned, robot, truth, rng)
    statuses, units, cameras = record_camera(stamps, true if stands else poses[frozen_now], truth, rng)
    return Drive(robot, stamps, true, ticks, statuses, units, cameras)


@pytest.mark.parametrize("sequence", ["straight", "square"])
@pytest.mark.parametrize("stands", [False, True])
@pytest.mark.parametrize("length_s", [1.5, 5.0])
def test_once_the_camera_moves_again_it_tells_whether_the_robot_stood(truth, fuse, sequence, stands, length_s):
    """While it shows one picture nobody knows; the motion from before to after is right in both cases."""
    drive = stopped_for_a_while(sequence, truth(), 8.0, length_s, stands)
    fused = fuse(drive)
    start_ns, off = int(drive.stamps[0]), []
    for state in fused.states:
        error = (state.pose - drive.pose_at(state.stamp_ns))[:2]
        sigmas = np.sqrt(error @ np.linalg.solve(state.covariance[:2, :2], error))
        if "wheels: slip" not in state.reasons and np.hypot(*error) > 0.05 and sigmas > 4.0:
            off.append(seconds(state.stamp_ns - start_ns))
    assert not off
    largest_m, largest_sigma_m = (0.1, 0.2) if stands else (0.3, 1.0)  # a camera that hangs leaves the wheels alone
    assert np.hypot(*error) < largest_m
    assert np.sqrt(np.trace(state.covariance[:2, :2])) < largest_sigma_m


def test_a_segment_that_begins_while_the_camera_is_doubted_is_a_new_one(simulate, truth, fuse, monkeypatch):
    """The height of its ceiling is that of another map, and is to be compared."""
    begun, begin, add = [], CeilingHeight.begin_segment, KeyframeBackend.add
    monkeypatch.setattr(CeilingHeight, "begin_segment", lambda height: begun.append(begin(height)))
    monkeypatch.setattr(KeyframeBackend, "add", lambda *args, **named: add(*args, **{**named, "use_camera": False}))
    drive = simulate("loops", 12.0, 3, truth(losses=((6.0, 7.0),)))
    fuse(drive)
    segments = {keyframe.segment for status in drive.statuses for keyframe in status.keyframes}
    assert len(segments) == 2
    assert len(begun) == 1 + len(segments), "once before all"


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
        outputs = fuse(blurred(loops, 4e-3, told)).states
        begin_ns = int(loops.stamps[0]) + nanoseconds(12.0)
        errors = [
            np.hypot(*(state.pose - loops.pose_at(state.stamp_ns))[:2])
            for state in outputs
            if begin_ns <= state.stamp_ns < begin_ns + nanoseconds(3.0)
        ]
        return np.sqrt(np.mean(np.square(errors)))

    assert rms_m(told=True) < 0.5 * rms_m(told=False)


@pytest.mark.parametrize("delay_s", [-0.08, 0.08, 0.15])
def test_images_that_are_stamped_late_or_early_are_said_and_covered(simulate, truth, fuse, delay_s):
    fused = fuse(simulate("square", 100.0, 2, truth(camera_delay_s=delay_s)))
    said = [any("its stamps are" in reason for reason in state.reasons) for state in fused.states]
    assert said[-1]
    told = re.search(r"its stamps are (0\.\d\d) s (late|early)", " ".join(fused.states[-1].reasons))
    assert told is not None
    assert float(told[1]) == pytest.approx(abs(delay_s), abs=0.015)
    assert told[2] == ("late" if delay_s > 0.0 else "early")
    since = said.index(True)
    assert fused.times_s[since] < 70.0  # four turns of the square
    errors = [planar.between(state.pose, fused.drive.pose_at(state.stamp_ns)) for state in fused.states[since:]]
    sigmas = [np.sqrt(np.diag(state.covariance)) for state in fused.states[since:]]
    assert np.mean([np.hypot(*error[:2]) < 4.0 * np.hypot(*sigma[:2]) for error, sigma in zip(errors, sigmas)]) > 0.95


@pytest.mark.parametrize("sequence", ["square", "loops", "spin", "stop_and_go"])
def test_stamps_that_are_right_are_not_blamed(simulate, truth, fuse, sequence):
    for seed in range(3):
        fused = fuse(simulate(sequence, 60.0, seed, truth(ratio=0.01, base=0.02, camera_delay_s=0.01)))
        assert not any("its stamps are" in reason for state in fused.states for reason in state.reasons)
