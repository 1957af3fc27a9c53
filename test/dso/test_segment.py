# SPDX-License-Identifier: BSD-3-Clause
"""What a segment says of an image."""

from types import SimpleNamespace

import numpy as np
import pytest

from ceiling_dso_ros.dso import CameraMotion, TrackingState
from ceiling_dso_ros.dso.compute.stage_timer import StageTimer
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.hosted_points import NO_HOSTED_POINTS
from ceiling_dso_ros.dso.images.frame import Frame
from ceiling_dso_ros.dso.segment import Segment

MOTION = se3.exp(np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.2]))


class FakeMapping:
    def __init__(self, *maps):
        self.map, self._news, self.keyframe_pending = (maps[-1] if maps else None), list(maps), False

    def take_news(self):
        news, self._news = self._news, []
        return news


def snapshot(stamp, keyframe_id, T_camera_world=np.eye(4), affine=(0.0, 0.0)):
    return SimpleNamespace(
        stamp_ns=stamp,
        reference=SimpleNamespace(keyframe_id=keyframe_id, T_camera_world=T_camera_world, affine=np.array(affine)),
        keyframes=[SimpleNamespace(keyframe_id=keyframe_id)],
        rmse=3.0,
        window_points=NO_HOSTED_POINTS,
        marginalized=NO_HOSTED_POINTS,
        active_points=7,
        candidate_points=8,
    )


FIRST_NS = -5


def segment(number=0, mapping=None, first_keyframe_id=10):
    trigger = SimpleNamespace(fires=lambda *_: True)
    start = SimpleNamespace(first_ns=FIRST_NS, metres_per_unit=4.0)
    return Segment(number, first_keyframe_id, np.eye(4), start, mapping or FakeMapping(), trigger)


def frame(stamp, T_camera_world=np.eye(4)):
    return Frame(stamp, 1.0, 0, T_camera_world, np.zeros(2))


def tracked(rmse=2.0):
    return SimpleNamespace(rmse=rmse, covariance=np.eye(6))


@pytest.mark.parametrize(("number", "state"), [(0, TrackingState.INITIALIZING), (1, TrackingState.RECOVERING)])
def test_only_later_segments_recover(number, state):
    status = segment(number).status_without_map(frame(1), "waiting", StageTimer())
    assert (status.state, status.segment, status.message) == (state, number, "waiting")
    assert status.T_world_camera is None
    assert status.active_points == 0
    assert status.predict_from_ns == FIRST_NS


def test_after_a_loss_the_next_image_is_the_first_one():
    status = segment().status_without_pose(7, TrackingState.LOST, "dark", StageTimer())
    assert status.predict_from_ns == 7


def test_metres_become_the_unit_of_the_segment():
    T = np.eye(4)
    T[0, 3] = 0.8
    motion = CameraMotion(T, np.diag([0.04, 0.04, 0.04, 1e-4, 1e-4, 1e-4]) ** 2, metric=True)
    converted = segment().in_unit(motion)
    assert converted.T_start_end[0, 3] == pytest.approx(0.2)
    assert not converted.metric
    sigma = np.sqrt(np.diag(converted.covariance))
    np.testing.assert_allclose(sigma[1:3], 0.01)  # across the motion
    assert sigma[0] == pytest.approx(np.hypot(0.01, 0.1 * 0.2))
    assert segment().in_unit(None) is None
    assert segment().in_unit(converted) is converted
    unknown = segment()
    unknown.start.metres_per_unit = None
    assert unknown.in_unit(motion) is None


def test_a_tracked_frame_is_told_and_remembered():
    current = snapshot(0, 11)
    ours = segment(mapping=FakeMapping(current))
    status = ours.status_with_pose(frame(1, MOTION), current, tracked(), False, StageTimer())
    np.testing.assert_allclose(status.T_world_camera, se3.inverse(MOTION))
    np.testing.assert_allclose(ours.T_world_camera, status.T_world_camera)
    np.testing.assert_allclose(status.T_keyframe_camera, status.T_world_camera)  # the keyframe is the world
    assert (status.keyframe_id, status.rmse, status.active_points) == (11, 2.0, 7)
    assert [keyframe.keyframe_id for keyframe in status.keyframes] == [11]
    again = ours.status_with_pose(frame(2, MOTION), current, tracked(), False, StageTimer())
    assert again.keyframes == ()


def test_a_frame_that_is_the_newest_keyframe_has_the_refined_pose():
    old, new = snapshot(0, 11), snapshot(1, 12, T_camera_world=MOTION, affine=(0.2, 5.0))
    ours = segment(mapping=FakeMapping(old, new))
    status = ours.status_with_pose(frame(1), old, tracked(), True, StageTimer())
    np.testing.assert_allclose(status.T_world_camera, se3.inverse(MOTION))
    np.testing.assert_allclose(status.T_keyframe_camera, np.eye(4), atol=1e-12)
    assert status.keyframe_id == 12
    np.testing.assert_array_equal(ours.history.affine, [0.2, 5.0])


def test_a_map_that_came_meanwhile_does_not_change_whom_the_frame_was_tracked_against():
    old, new = snapshot(0, 11), snapshot(1, 12, T_camera_world=MOTION)
    status = segment(mapping=FakeMapping(old, new)).status_with_pose(frame(2), old, tracked(), False, StageTimer())
    assert status.keyframe_id == 11


def test_poses_on_a_young_map_are_known_less_well():
    sigmas = [
        segment(mapping=FakeMapping(snapshot(0, keyframe_id), snapshot(0, keyframe_id)))
        .status_with_pose(frame(1), snapshot(0, keyframe_id), tracked(), False, StageTimer())
        .covariance[0, 0]
        for keyframe_id in (11, 20, 60)
    ]
    assert sigmas == sorted(sigmas, reverse=True)
    assert sigmas[0] > 2.0 * sigmas[2]


def test_no_keyframe_while_another_one_is_in_work():
    ours = segment()
    assert ours.needs_keyframe(frame(1), tracked(), None)
    ours.mapping.keyframe_pending = True
    assert not ours.needs_keyframe(frame(1), tracked(), None)
