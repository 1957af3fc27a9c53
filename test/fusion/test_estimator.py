# SPDX-License-Identifier: BSD-3-Clause
import dataclasses

import numpy as np
import pytest

from ceiling_dso_ros.dso.config import ConfigError
from ceiling_dso_ros.dso.durations import nanoseconds
from ceiling_dso_ros.dso.status import OdometryStatus, TrackingState
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.config import FusionConfig, OutputConfig, ScaleConfig
from ceiling_dso_ros.fusion.estimator import FusionEstimator
from ceiling_dso_ros.fusion.state import FusionState


def test_every_wheel_sample_but_the_first_gives_an_output(fused):
    assert len(fused.states) == len(fused.drive.ticks) - 1
    assert (np.diff(fused.stamps) > 0).all()


def test_covariances_are_finite_symmetric_and_positive(fused):
    for state in fused.states[::50]:
        for covariance in (state.covariance, state.twist_covariance):
            np.testing.assert_allclose(covariance, covariance.T, atol=1e-12)
            assert (np.linalg.eigvalsh(covariance) > 0).all()


def test_the_twist_is_the_true_one(fused):
    for state in fused.states[200::100]:
        step = (
            planar.between(*(fused.drive.pose_at(state.stamp_ns + dt_ns) for dt_ns in (-20_000_000, 20_000_000))) / 0.04
        )
        np.testing.assert_allclose(state.twist, step[[0, 2]], atol=0.1)


def test_until_the_scale_is_known_the_pose_is_wheel_odometry(fused):
    unscaled = [i for i, state in enumerate(fused.states) if state.state is FusionState.NOT_SCALED]
    assert unscaled == list(range(len(unscaled)))
    assert 50 < len(unscaled) < 400
    np.testing.assert_allclose(fused.poses[unscaled], fused.wheel_poses[unscaled], atol=1e-12)
    assert all("scale: not known yet" in fused.states[i].reasons for i in unscaled)
    assert not fused.states[unscaled[-1]].scale.converged
    assert fused.states[-1].state is FusionState.CONVERGED
    assert fused.states[-1].reasons == ()


def test_a_camera_that_is_never_scaled_never_shows_in_the_pose(loops, fuse):
    never = FusionConfig(scale=ScaleConfig(converged_sigma=1e-4))
    fused = fuse(loops, never)
    np.testing.assert_allclose(fused.poses, fused.wheel_poses, atol=1e-12)
    assert {state.state for state in fused.states} == {FusionState.NOT_SCALED}


def test_the_same_events_give_the_same_bytes(loops, fuse, fused):
    again = fuse(loops)
    assert again.poses.tobytes() == fused.poses.tobytes()
    np.testing.assert_array_equal(
        [node.pose for node in again.estimator.smoothed()], [node.pose for node in fused.estimator.smoothed()]
    )


def test_an_output_depends_on_nothing_that_comes_later(loops, fuse, fused):
    half = dataclasses.replace(
        loops,
        ticks=loops.ticks[: len(loops.ticks) // 2],
        statuses=[status for status in loops.statuses if status.stamp_ns <= loops.ticks[len(loops.ticks) // 2][0]],
    )
    poses = fuse(half).poses
    assert poses.tobytes() == fused.poses[: len(poses)].tobytes()


def test_keyframes_that_come_late_change_little(loops, fused):
    """As from a node that optimises in another thread: the window is published 0.15 s after its frame."""
    estimator = FusionEstimator(loops.robot)
    events = [(stamp, order, data) for stamp, order, data in loops.events()]
    events += [(status.stamp_ns + 150_000_000, 2, status) for status in loops.statuses if status.keyframes]
    poses = []
    for stamp_ns, kind, data in sorted(events, key=lambda event: event[:2]):
        if kind == 0:
            state = estimator.add_wheel_ticks(stamp_ns, *data)
            poses += [] if state is None else [state.pose]
        elif kind == 1:
            estimator.add_frame(data)
        else:
            estimator.add_keyframes(data)
    errors = [np.hypot(*(a - b)[:2]) for a, b in zip(poses, fused.truth(fused.stamps))]
    assert max(errors) < 0.05


def test_set_pose_moves_the_output_and_goes_on_from_there(loops):
    estimator = FusionEstimator(loops.robot)
    wanted, states = np.array([5.0, -3.0, 2.0]), []
    for index, (stamp_ns, *counts) in enumerate(loops.ticks[:200]):
        if index == 150:
            estimator.set_pose(wanted)
        states.append(estimator.add_wheel_ticks(stamp_ns, *counts))
    stayed = FusionEstimator(loops.robot)
    poses = [state.pose for state in (stayed.add_wheel_ticks(*sample) for sample in loops.ticks[:200]) if state]
    np.testing.assert_allclose(
        planar.between(wanted, states[199].pose), planar.between(poses[148], poses[198]), atol=1e-9
    )


@pytest.mark.long
def test_reset_begins_anew(loops, fuse, fused):
    estimator = FusionEstimator(loops.robot, keep_history=True)
    for _ in range(2):
        poses = []
        for stamp_ns, is_camera, data in loops.events():
            if is_camera:
                estimator.add_keyframes(data)
                estimator.add_frame(data)
            else:
                state = estimator.add_wheel_ticks(stamp_ns, *data)
                poses += [] if state is None else [state.pose]
        assert np.array(poses).tobytes() == fused.poses.tobytes()
        estimator.reset()


def test_images_without_wheels_give_no_pose(loops):
    estimator = FusionEstimator(loops.robot)
    for status in loops.statuses[:200]:
        assert estimator.add_keyframes(status) is None
        assert estimator.add_frame(status) is None
    assert np.isnan(estimator.scale.value)
    assert estimator._waiting == []


@pytest.mark.long
def test_a_robot_that_has_an_odometry_needs_no_ticks(loops, fused):
    """Any frame will do: here it does not begin at zero. The resolution, which ticks know, is found from the poses."""
    elsewhere, estimator, poses = np.array([7.0, -2.0, 1.0]), FusionEstimator(loops.robot), []
    odometry = iter([elsewhere, *(planar.compose(elsewhere, pose) for pose in fused.wheel_poses)])
    for stamp_ns, is_camera, data in loops.events():
        if is_camera:
            estimator.add_keyframes(data)
            estimator.add_frame(data)
        else:
            state = estimator.add_wheel_odometry(stamp_ns, next(odometry))
            poses += [] if state is None else [state.pose]
    np.testing.assert_allclose(poses, fused.poses, atol=1e-5)


@pytest.mark.long
def test_repeated_and_disordered_images_are_no_harm(loops, fuse, fused):
    statuses = list(loops.statuses)
    for index in range(300, 600, 7):
        statuses[index : index + 2] = [statuses[index + 1], statuses[index], statuses[index]]
    estimator = FusionEstimator(loops.robot)
    events = iter(statuses)
    status, poses = next(events), []
    for stamp_ns, *counts in loops.ticks:
        while status is not None and status.stamp_ns <= stamp_ns:
            estimator.add_keyframes(status)
            estimator.add_frame(status)
            status = next(events, None)
        state = estimator.add_wheel_ticks(stamp_ns, *counts)
        poses += [] if state is None else [state.pose]
    assert np.abs(np.array(poses)[:, :2] - fused.poses[:, :2]).max() < 0.02


@pytest.mark.long
def test_an_odometry_that_is_reset_begins_a_new_segment(simulate, truth, fuse):
    """Its keyframes count from 0 again."""
    drive = simulate("loops", 30.0, 9, truth(losses=((14.0, 15.0),)))
    first = min(s.keyframes[0].keyframe_id for s in drive.statuses if s.keyframes and s.segment == 1)

    def renumbered(status):
        if status.segment == 0:
            return status
        keyframes = tuple(
            dataclasses.replace(k, keyframe_id=k.keyframe_id - first, segment=0) for k in status.keyframes
        )
        key = status.keyframe_id - first if status.keyframe_id >= 0 else -1
        return dataclasses.replace(status, keyframes=keyframes, keyframe_id=key, segment=0)

    reset = dataclasses.replace(drive, statuses=[renumbered(status) for status in drive.statuses])
    fused = fuse(reset)
    assert fused.states[-1].state is FusionState.CONVERGED
    assert fused.states[-1].scale.value == pytest.approx(fuse(drive).states[-1].scale.value, rel=1e-6)


def test_prediction_is_the_motion_of_the_camera_in_its_own_unit(loops):
    estimator, checked = FusionEstimator(loops.robot), 0
    before = None
    for stamp_ns, is_camera, data in loops.events():
        if not is_camera:
            estimator.add_wheel_ticks(stamp_ns, *data)
            continue
        if before is not None and data.state is TrackingState.TRACKING and estimator.scale.converged:
            motion = estimator.predict_camera_motion(before, data.stamp_ns)
            if before.keyframe_id == data.keyframe_id:
                seen = np.linalg.inv(before.T_keyframe_camera) @ data.T_keyframe_camera
                error = seen[:3, 3] - motion.T_start_end[:3, 3]
                sigma = np.sqrt(np.diag(motion.covariance)[:3])
                assert (np.abs(error) < 5.0 * sigma + 1e-3).all()
                assert np.linalg.norm(error) < 0.003
                checked += 1
        estimator.add_keyframes(data)
        estimator.add_frame(data)
        before = data if data.state is TrackingState.TRACKING else None
    assert checked > 200


def test_prediction_needs_wheels_and_a_keyframe(loops):
    image = next(status for status in loops.statuses if status.state is TrackingState.TRACKING)
    assert FusionEstimator(loops.robot).predict_camera_motion(image, image.stamp_ns + 100_000_000) is None


def test_a_prediction_is_in_metres_while_the_unit_is_not_known(loops, fused):
    """The first images of a new segment are tracked before the fusion has a scale for it."""
    last = next(status for status in reversed(loops.statuses) if status.state is TrackingState.TRACKING)
    later_ns = last.stamp_ns + 30_000_000
    known = fused.estimator.predict_camera_motion(last, later_ns)
    assert not known.metric
    for change in ({"segment": last.segment + 1}, {"state": TrackingState.LOST}):
        metric = fused.estimator.predict_camera_motion(dataclasses.replace(last, **change), later_ns)
        assert metric.metric
        in_unit = metric.in_unit(fused.estimator.scale.value, fused.estimator.newest_keyframe.scale_sigma)
        np.testing.assert_allclose(in_unit.T_start_end, known.T_start_end, atol=1e-12)
        np.testing.assert_allclose(in_unit.covariance, known.covariance, rtol=1e-9, atol=1e-15)
    assert fused.estimator.predict_camera_motion(last, last.stamp_ns) is None


def test_a_prediction_begins_where_the_odometry_asks_for_it(loops, fused):
    last = next(status for status in reversed(loops.statuses) if status.state is TrackingState.TRACKING)
    earlier_ns, later_ns = last.stamp_ns - 500_000_000, last.stamp_ns + 30_000_000
    asked = dataclasses.replace(last, state=TrackingState.RETRYING, earlier_start_ns=earlier_ns)
    whole = fused.estimator.predict_camera_motion(asked, later_ns).T_start_end
    first = fused.estimator.predict_camera_motion(asked, last.stamp_ns + 1).T_start_end
    np.testing.assert_allclose(
        whole, first @ fused.estimator.predict_camera_motion(last, later_ns).T_start_end, atol=1e-6
    )
    forgotten = dataclasses.replace(asked, earlier_start_ns=last.stamp_ns - 60_000_000_000)
    assert fused.estimator.predict_camera_motion(forgotten, later_ns) is None


def test_a_lost_image_before_anything_else_is_no_harm(loops):
    estimator = FusionEstimator(loops.robot)
    status = OdometryStatus(int(loops.stamps[0]), TrackingState.LOST, 0, message="dark")
    estimator.add_keyframes(status)
    estimator.add_frame(status)
    states = [estimator.add_wheel_ticks(*sample) for sample in loops.ticks[:5]]
    assert "camera: lost (dark)" in states[-1].reasons


def test_corrections_are_no_larger_than_configured(loops, fuse):
    narrow = FusionConfig(output=OutputConfig(max_correction_m_s=0.05, max_correction_rad_s=0.05))
    fused = fuse(loops, narrow)
    assert fused.largest_jump() < 0.001 + 0.002  # and the wheels' own noise


def test_a_robot_that_stands_when_the_fusion_begins_is_seen_at_once(simulate, truth, fuse):
    """The window is older than the first wheel sample; what comes later is as good as if it had been there."""
    drive = simulate("stop_and_go", 25.0, 4, truth())
    standing = drive.stamps[0] + nanoseconds(10.5)
    window = next(status for status in reversed(drive.statuses) if status.keyframes and status.stamp_ns < standing)
    later = [status for status in drive.statuses if status.stamp_ns > standing]
    estimator, states = FusionEstimator(drive.robot), []
    estimator.add_keyframes(window)
    for stamp_ns, is_camera, data in dataclasses.replace(drive, statuses=later).events():
        if stamp_ns < standing - nanoseconds(0.1):
            continue
        if is_camera:
            estimator.add_keyframes(data)
            estimator.add_frame(data)
            if len(states) == 20:
                assert estimator.scale.segment == window.segment
        else:
            states.append(estimator.add_wheel_ticks(stamp_ns, *data))
    assert states[-1].state is FusionState.CONVERGED
    assert states[-1].scale.value == pytest.approx(drive.metres_per_unit[later[-1].keyframe_id], rel=0.01)
    begin, end = drive.pose_at(standing - nanoseconds(0.1)), drive.pose_at(states[-1].stamp_ns)
    assert np.hypot(*(states[-1].pose - planar.between(begin, end))[:2]) < 0.05


@pytest.mark.long
def test_another_output_on_the_way_changes_what_follows_and_not_what_is_known(loops, fused):
    narrow = OutputConfig(blend_s=1.0, max_correction_m_s=0.025, max_correction_rad_s=0.05)
    estimator, states, middle = FusionEstimator(loops.robot, keep_history=True), [], len(fused.states) // 2
    for stamp_ns, is_camera, data in loops.events():
        if is_camera:
            estimator.add_keyframes(data)
            estimator.add_frame(data)
        else:
            state = estimator.add_wheel_ticks(stamp_ns, *data)
            states += [] if state is None else [state]
        if len(states) == middle and estimator.config.output != narrow:
            estimator.configure_output(narrow)
    poses = np.array([state.pose for state in states])
    np.testing.assert_array_equal(poses[:middle], fused.poses[:middle])
    assert (poses[middle:] != fused.poses[middle:]).any()
    assert [state.scale for state in states] == [state.scale for state in fused.states]
    steps = [planar.between(a, b) for a, b in zip(poses, poses[1:])]
    usual = [planar.between(a, b) for a, b in zip(fused.poses, fused.poses[1:])]
    assert np.abs(steps[middle - 1]).max() <= np.abs(usual).max()
    estimator.reset()
    assert estimator.config.output == narrow


def test_an_output_out_of_range_is_refused_and_the_old_one_stays(loops):
    estimator = FusionEstimator(loops.robot)
    with pytest.raises(ConfigError, match=r"output\.blend_s"):
        estimator.configure_output(OutputConfig(blend_s=0.0))
    assert estimator.config.output == OutputConfig()
