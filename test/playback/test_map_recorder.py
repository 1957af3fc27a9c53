# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.dso.hosted_points import NO_HOSTED_POINTS, HostedPoints
from ceiling_dso_ros.dso.status import KeyframeEstimate, OdometryStatus, TrackingState
from ceiling_dso_ros.playback.map_recorder import MapRecorder
from ceiling_dso_ros.playback.trajectory_recorder import TrajectoryRecorder


def points(*keyframe_and_depth):
    ids, depths = np.array(keyframe_and_depth).T
    return HostedPoints(
        ids.astype(np.int64), np.column_stack([0 * depths, 0 * depths, depths]), (10 * depths).astype(np.float32)
    )


def status(x_of_keyframes, window, marginalized=NO_HOSTED_POINTS, segment=0, state=TrackingState.INITIALIZING):
    """The keyframes are where their dictionary says."""
    poses = {number: np.eye(4) for number in x_of_keyframes}
    for number, x in x_of_keyframes.items():
        poses[number][0, 3] = x
    keyframes = tuple(KeyframeEstimate(n, n * 10**9, segment, T, (0.0, 0.0), False) for n, T in poses.items())
    return OdometryStatus(0, state, segment, keyframes=keyframes, window_points=window, marginalized=marginalized)


def nothing_new(segment=0):
    return OdometryStatus(0, TrackingState.INITIALIZING, segment)


def cloud_of(*statuses):
    trajectories, recorder = TrajectoryRecorder(), MapRecorder()
    for each in statuses:
        trajectories.add(each)
        recorder.add(each)
    return recorder.cloud(trajectories.estimates)


def rows(cloud):
    """(segment, keyframe, x, z, grey) of each point, in an order of their own."""
    return sorted(
        zip(
            cloud.segments.tolist(),
            cloud.keyframe_ids.tolist(),
            cloud.positions[:, 0],
            cloud.positions[:, 2],
            cloud.grey,
        )
    )


def test_points_that_left_move_on_with_their_keyframe_and_only_the_last_window_counts():
    cloud = cloud_of(
        status({0: 0.0, 1: 1.0}, points((0, 2.0), (0, 3.0), (1, 4.0))),
        nothing_new(),
        status({0: 0.1, 1: 1.1}, points((0, 3.0), (1, 4.5)), marginalized=points((0, 2.0))),
        status({0: 0.2, 1: 1.2}, points((1, 5.0)), marginalized=points((0, 3.0))),
        nothing_new(),
    )
    assert rows(cloud) == [(0, 0, 0.2, 2.0, 20.0), (0, 0, 0.2, 3.0, 30.0), (0, 1, 1.2, 5.0, 50.0)]


def test_a_lost_segment_keeps_its_last_window():
    cloud = cloud_of(
        status({0: 0.0}, points((0, 1.0))),
        status({0: 0.5}, points((0, 2.0)), state=TrackingState.LOST),
        nothing_new(segment=1),
        status({1: 7.0}, points((1, 3.0)), segment=1),
    )
    assert rows(cloud) == [(0, 0, 0.5, 2.0, 20.0), (1, 1, 7.0, 3.0, 30.0)]


def test_a_window_without_points_takes_the_place_of_the_one_before():
    cloud = cloud_of(status({0: 0.0}, points((0, 1.0))), status({0: 0.0}, NO_HOSTED_POINTS))
    assert len(cloud) == 0


def test_nothing_recorded_gives_an_empty_cloud():
    cloud = cloud_of(nothing_new())
    assert len(cloud) == len(cloud.segments) == len(cloud.keyframe_ids) == len(cloud.grey) == 0
    assert cloud.positions.shape == (0, 3)


def test_points_of_an_unknown_keyframe_are_refused():
    recorder = MapRecorder()
    recorder.add(status({0: 0.0}, points((5, 1.0))))
    with pytest.raises(KeyError, match="5"):
        recorder.cloud({})
